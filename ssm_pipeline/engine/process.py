"""Properties of the process: allocator, threads, package versions."""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import os
import platform
import sys
import threading
import time

import psutil

from ssm_pipeline.records import StudyError

# Constants from glibc's malloc.h, copied because reading the header needs a compiler.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4
MEMORY_PER_JOB_GB = 2.0  # a whole chest CT's mask during meshing
# OMP: PyTorch, pykdtree; the others: the linear algebra of NumPy and SciPy.
THREAD_COUNTS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
REPORTED_PACKAGES = ("ssm-pipeline", "numpy", "scipy", "torch", "simpleitk", "vtk", "pymeshlab")


def keep_large_blocks() -> bool:
    """Tell glibc to keep freed memory instead of giving it back to the system.

    PyTorch on CPU allocates and frees the same large blocks every step; returning them each time
    costs page faults.

    Returns:
        False where there is no glibc.
    """
    try:
        libc = ctypes.CDLL("libc.so.6")
        mallopt = libc.mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(M_MMAP_MAX, 0) and mallopt(M_TRIM_THRESHOLD, 2**31 - 1))


def available_cores() -> int:
    """Cores this process may use: fewer than the machine's under a container's CPU set."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def default_jobs() -> int:
    """Return one process per core, but no more than fit into the free memory."""
    free_gb = psutil.virtual_memory().available / 2**30
    return max(1, min(available_cores(), int(free_gb / MEMORY_PER_JOB_GB)))


@functools.cache  # one watch a process, however many cases it is given
def end_with_parent(parent: int) -> None:
    """End this worker process within a second of its parent's death.

    Otherwise the workers of a killed run would still write to the folders of the next run.
    """

    def watch() -> None:
        # Windows keeps the number of a parent that has died; the others give it a new parent.
        while os.getppid() == parent and psutil.pid_exists(parent):
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@functools.cache
def may_grow() -> None:
    """Let this joblib worker process hold as much memory as its work needs.

    joblib takes growth of 300 MB after the first case for a leak, and ends the worker with a
    warning. Here the growth comes from a larger organ or the libraries of a later stage. joblib has
    no setting for this.
    """
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize


def holds_one_thread() -> bool:
    """Whether this process was started with one thread for every library that counts its own."""
    return all(os.environ.get(name) == "1" for name in THREAD_COUNTS)


def versions() -> dict[str, str]:
    """Return the versions of Python, the platform and the packages that results depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in REPORTED_PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, str | int]:
    """Return properties of the machine that may change the last bits of a result."""
    found: dict[str, str | int] = {"processor": platform.processor() or platform.machine()}
    found["cores"] = available_cores()
    for name in THREAD_COUNTS:
        if name in os.environ:
            found[name] = os.environ[name]
    if torch := sys.modules.get("torch"):
        found["torch_threads"] = torch.get_num_threads()
    return found


def chosen_device(wanted: str | None) -> str:
    """Return the requested device; by default cuda if available, else cpu.

    Raises:
        StudyError: If the device is not available.
    """
    import torch

    if wanted is None:
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.empty(1, device=wanted)
    except (RuntimeError, AssertionError) as error:
        raise StudyError(
            f"--device {wanted} can't be used: {str(error).splitlines()[0]} Use --device cpu."
        ) from error
    return wanted

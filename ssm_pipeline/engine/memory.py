"""The memory of a process: its peak, and a limit to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil


def forget_peak_memory() -> None:
    """Start the peak afresh, so that it belongs to one stage (Linux; elsewhere it accumulates)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def peak_memory_mb() -> float:
    """Largest resident memory of this process, MB: on Linux since `forget_peak_memory`, on Windows
    since its start; on macOS the memory it holds now."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
        line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    except (OSError, StopIteration):
        memory = psutil.Process().memory_info()
        # Windows keeps the peak; macOS does not, so that it is today's size there.
        result: float = getattr(memory, "peak_wset", memory.rss) / 2**20
        return result


@contextmanager
def memory_capped(gigabytes: float | None) -> Iterator[None]:
    """Inside the block this process gets no more memory than so many GB: an allocation fails, and
    the system has nothing to kill. None, or where the system knows no such limit (Windows, macOS):
    as it is.
    """
    if gigabytes is None or not hasattr(psutil, "RLIMIT_DATA"):
        yield
        return
    # Of what the process holds itself: the address space (RLIMIT_AS) counts libraries' files too,
    # and PyTorch's are larger than many a case.
    this = psutil.Process()
    before, most = this.rlimit(psutil.RLIMIT_DATA)
    wanted = int(gigabytes * 2**30)
    this.rlimit(psutil.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))
    try:
        yield
    finally:
        this.rlimit(psutil.RLIMIT_DATA, (before, most))


def is_want_of_memory(error: BaseException) -> bool:
    """Whether an allocation failed: PyTorch has no MemoryError."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "can't allocate memory" in str(error)
    )

"""Measure a process's peak memory, and limit its memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil


def forget_peak_memory() -> None:
    """Reset the peak, so that it belongs to one stage (on Linux; elsewhere it accumulates)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process in MB.

    On Linux it is the peak since `forget_peak_memory`, on Windows the peak since the process
    started, and on macOS the current size.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
        line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    except (OSError, StopIteration):
        memory = psutil.Process().memory_info()
        # Windows reports a peak; macOS does not, so the current size is used there.
        result: float = getattr(memory, "peak_wset", memory.rss) / 2**20
        return result


@contextmanager
def memory_capped(gigabytes: float | None) -> Iterator[None]:
    """Limit this process's memory inside the block, in GB.

    Beyond the limit an allocation fails, so that the system does not kill the process. There is no
    limit if `gigabytes` is None or the system does not support one (Windows, macOS).
    """
    if gigabytes is None or not hasattr(psutil, "RLIMIT_DATA"):
        yield
        return
    # Only the process's own data is limited: the address space (RLIMIT_AS) also counts the files of
    # libraries, and PyTorch's are larger than many cases.
    this = psutil.Process()
    before, most = this.rlimit(psutil.RLIMIT_DATA)
    wanted = int(gigabytes * 2**30)
    this.rlimit(psutil.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))
    try:
        yield
    finally:
        this.rlimit(psutil.RLIMIT_DATA, (before, most))


def is_want_of_memory(error: BaseException) -> bool:
    """Return whether an error is a failed allocation; PyTorch raises no MemoryError."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "can't allocate memory" in str(error)
    )

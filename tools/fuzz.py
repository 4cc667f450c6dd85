"""Feed damaged files to every reader of files from outside, and count what should not happen.

    python tools/fuzz.py --count 10000                 # all readers, an hour or so
    python tools/fuzz.py --count 2000 --reader nrrd    # one of them
    python tools/fuzz.py --list

An input is fine if it is read, or refused with one of the program's own errors. What is not: an
error of another kind, a process that dies, more than 10 s, more than 2 GB. The inputs follow from
`--seed` and their number; those that were not fine are kept in `--keep`. Linux only.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = map(str, (ROOT, ROOT / "tools", ROOT / "tests"))
from fuzz_outside_files import OUTSIDE_FILES  # noqa: E402
from fuzz_own_files import OWN_FILES  # noqa: E402
from fuzz_reader import Reader  # noqa: E402

READERS = OUTSIDE_FILES + OWN_FILES

LONGEST_S = 10.0
MOST_BYTES = 2 * 2**30
EXTREME = (b"-1", b"0", b"nan", b"1e308", b"4294967296", b"99999999999999999999", b"", b"\xff")
BINARY_EXTREMES = (
    b"\xff" * 8,  # -1, the largest unsigned number, not a number
    b"\0" * 8,
    b"\xff\xff\xff\x7f" * 2,  # the largest int32, twice
    b"\0\0\0\x80" * 2,  # the smallest int32
    b"\0\0\x80\x7f" * 2,  # infinite in single precision
)


@dataclass
class Verdict:
    """What a reader made of its inputs; `bad` is (number of the input, what happened)."""

    reader: str
    read: int = 0
    refused: int = 0
    bad: list[tuple[int, str]] = field(default_factory=list)

    def line(self) -> str:
        kinds = Counter(what.split(":")[0] for _, what in self.bad)
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "none"
        total = self.read + self.refused + len(self.bad)
        counts = f"{total:>7} inputs{self.read:>7} read{self.refused:>7} refused"
        return f"{self.reader:<16}{counts}   bad: {found}"


def damaged(content: bytes, generator: np.random.Generator) -> bytes:
    """The content with one to four things done to it that disks, networks and people do."""
    data = bytearray(content)
    for _ in range(int(generator.integers(1, 5))):
        if not data:
            break
        here = int(generator.integers(len(data)))
        length = int(generator.integers(1, 1 + min(64, len(data) - here)))
        match int(generator.integers(10)):
            case 0:
                data[here] ^= 1 << int(generator.integers(8))
            case 1:
                data[here] = int(generator.integers(256))
            case 2:
                del data[here:]
            case 3:
                del data[here : here + length]
            case 4:
                data[here : here + length] = bytes(length)
            case 5:
                data[here:here] = data[here : here + length]
            case 6:
                data[here:here] = generator.bytes(length)
            case 7:
                there = int(generator.integers(len(data)))
                data[here : here + length] = data[there : there + length]
            case 8:
                numbers = list(re.finditer(rb"-?\d+(\.\d+)?", data))
                if numbers:
                    found = numbers[int(generator.integers(len(numbers)))]
                    data[found.start() : found.end()] = EXTREME[int(generator.integers(8))]
            case 9:
                width = int(generator.choice([1, 2, 4, 8]))
                pattern = BINARY_EXTREMES[int(generator.integers(len(BINARY_EXTREMES)))]
                data[here : here + width] = pattern[-width:]
    return bytes(data)


def input_of(reader: Reader, good: bytes, seed: int, number: int) -> bytes:
    generator = np.random.default_rng([seed, number])
    if reader.inner is None:
        return damaged(good, generator)
    unpack, pack = reader.inner
    return pack(damaged(unpack(good), generator))


def read_inputs(
    reader: Reader, folder: Path, seed: int, numbers: range, results: Connection
) -> None:
    """In a process of its own: sends (number, None) before each input and (number, what) after."""
    from ssm_pipeline.records import CaseError, StudyError

    warnings.simplefilter("ignore")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # C++ readers say much about damaged files
    path = reader.write(folder)
    good = path.read_bytes()
    reader.read(path)  # imports, once, before memory is counted
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    # The soft limit alone: the process that reads VTK's files sets one of its own.
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, resource.RLIM_INFINITY))
    reader.read(path)
    for number in numbers:
        content = input_of(reader, good, seed, number)
        path.write_bytes(content)
        results.send((number, None))
        try:
            reader.read(path)
        except (CaseError, StudyError):
            results.send((number, "refused"))
        except BaseException as error:
            what = f"{type(error).__name__}: {str(error)[:200]}"
            results.send((number, what))
        else:
            results.send((number, "read"))
    results.send((numbers.stop, None))


def fuzz(reader: Reader, count: int, seed: int = 0, longest_s: float = LONGEST_S) -> Verdict:
    """Read inputs 0 … count − 1 of a reader, in processes, the next where one dies or hangs."""
    verdict, start = Verdict(reader.name), 0
    context = multiprocessing.get_context("spawn")
    while start < count:
        with tempfile.TemporaryDirectory() as folder:
            ours, theirs = context.Pipe(duplex=False)
            batch = range(start, min(count, start + 2000))
            child = context.Process(
                target=_read_inputs_of, args=(reader.name, Path(folder), seed, batch, theirs)
            )
            child.start()
            theirs.close()
            start = _watch(verdict, child, ours, batch, longest_s)
    return verdict


def _read_inputs_of(name: str, folder: Path, seed: int, batch: range, results: Connection) -> None:
    read_inputs(next(r for r in READERS if r.name == name), folder, seed, batch, results)


def _watch(
    verdict: Verdict,
    child: multiprocessing.context.SpawnProcess,
    results: Connection,
    batch: range,
    longest_s: float,
) -> int:
    """Collect a batch's results. Returns the number to go on with."""
    current, patience, used = batch.start, 120.0, 0.0  # the first message waits for the imports
    try:
        # On a busy machine 10 s may pass without work: the process's own seconds count.
        while results.poll(patience) or _seconds_of(child) - used < longest_s:
            if not results.poll():
                continue
            number, what = results.recv()
            current, patience, used = number, longest_s, _seconds_of(child)
            if what == "read":
                verdict.read += 1
            elif what == "refused":
                verdict.refused += 1
            elif what is not None:
                verdict.bad.append((number, what))
            elif number == batch.stop:
                child.join()
                return batch.stop
        child.kill()
        what = f"hang: over {longest_s:.0f} s"
    except EOFError:
        child.join()
        what = f"died: exit code {child.exitcode}"
    child.join()
    if patience != longest_s:
        raise RuntimeError(f"{verdict.reader}: the good file can't be read ({what})")
    verdict.bad.append((current, what))
    return current + 1


def _seconds_of(child: multiprocessing.context.SpawnProcess) -> float:
    """Of a core, used by a process so far; endless where it has ended."""
    try:
        fields = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("inf")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def keep(reader: Reader, verdict: Verdict, seed: int, folder: Path) -> None:
    """One input of each kind of failure, to become a test."""
    kinds = {what.split(":")[0]: number for number, what in reversed(verdict.bad)}
    for number in kinds.values():
        with tempfile.TemporaryDirectory() as place:
            path = reader.write(Path(place))
            content = input_of(reader, path.read_bytes(), seed, number)
        target = folder / reader.name.replace(" ", "-") / f"{seed}-{number}-{path.name}"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="inputs a reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", help="some readers only")
    parser.add_argument("--keep", type=Path, help="folder for the inputs that were not fine")
    parser.add_argument("--list", action="store_true", help="name the readers")
    options = parser.parse_args()
    if options.list:
        print("\n".join(reader.name for reader in READERS))
        return 0
    worst = 0
    for reader in READERS:
        if options.reader and reader.name not in options.reader:
            continue
        start = time.perf_counter()
        verdict = fuzz(reader, options.count, options.seed)
        print(f"{verdict.line()}   {time.perf_counter() - start:.0f} s", flush=True)
        for what in sorted({what for _, what in verdict.bad})[:8]:
            print(f"    {what.splitlines()[0]}", flush=True)
        if options.keep:
            keep(reader, verdict, options.seed, options.keep)
        worst = max(worst, len(verdict.bad))
    return 1 if worst else 0


if __name__ == "__main__":
    sys.exit(main())

"""Every reader of files from outside, fed what once broke one, and a few damaged files more.

`tools/fuzz.py` feeds each of them ten thousand.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from ssm_pipeline.records import CaseError, StudyError

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
import fuzz_outside_files as outside  # noqa: E402
import fuzz_own_files as own  # noqa: E402
from fuzz import READERS, input_of  # noqa: E402
from fuzz_reader import Reader  # noqa: E402

CORPUS = sorted((ROOT / "tests" / "corpus").iterdir())
READ_BY: dict[str, Callable[[Path], object]] = {
    ".mha": outside.read_organ,
    ".off": outside.read_surface,
    ".obj": outside.read_surface,
    ".vtp": outside.read_surface,
    ".yaml": outside.read_study,
    ".pt": own.read_matcher,
    ".json": outside.read_markups,
}
COUNT = 200  # damaged files a reader


def typed(read: Callable[[Path], object], path: Path) -> None:
    """Read a file; only the program's own errors are fine."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read(path)
        except (CaseError, StudyError):
            return


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_once_broke_a_reader_does_so_no_more(path: Path) -> None:
    """In a process of its own, since some of them ended it, or kept it."""
    context = multiprocessing.get_context("fork")
    child = context.Process(target=typed, args=(READ_BY[path.suffix], path))
    child.start()
    child.join(60)
    child.kill()
    child.join()
    assert child.exitcode == 0


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_damaged_files_are_read_or_refused(reader: Reader, tmp_path: Path) -> None:
    path = reader.write(tmp_path)
    good = path.read_bytes()
    reader.read(path)
    for number in range(COUNT):
        path.write_bytes(input_of(reader, good, 1, number))
        typed(reader.read, path)


def test_no_pickle_is_run(tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    (tmp_path / "matcher.pt").write_bytes(f"cos\nsystem\n(S'touch {ran}'\ntR.".encode())
    with pytest.raises(StudyError):
        own.read_matcher(tmp_path / "matcher.pt")
    assert not ran.exists()


def test_the_check_sees_an_untyped_error(tmp_path: Path) -> None:
    def broken(path: Path) -> None:
        raise ZeroDivisionError

    with tempfile.NamedTemporaryFile() as file, pytest.raises(ZeroDivisionError):
        typed(broken, Path(file.name))

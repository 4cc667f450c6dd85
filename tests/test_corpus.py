"""Files that once crashed a reader, hung it, or broke it in an untyped error: now refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ssm_pipeline.records import CaseError, StudyError

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


def reader_of(path: Path) -> Callable[[Path], object]:
    if path.name.endswith(".mrk.json"):
        from ssm_pipeline.data_prep.formats.landmarks import read_landmarks

        return read_landmarks
    if path.suffix == ".mha":
        from ssm_pipeline.data_prep.formats.images import read_organ

        return lambda file: read_organ(file, (3,), "case")
    if path.suffix == ".pt":
        from ssm_pipeline.training.matcher import load_matcher

        return load_matcher
    if path.suffix == ".yaml":
        from ssm_pipeline.study.study import read_study

        return lambda file: read_study(str(file))
    from ssm_pipeline.data_prep.formats.surface_files import read_mesh

    return read_mesh


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_a_damaged_file_is_refused_by_an_error_that_names_it(path: Path) -> None:
    with pytest.raises((CaseError, StudyError)) as refused:
        reader_of(path)(path)
    assert path.name.split(".")[0] in str(refused.value)

"""The digest of code changes with every statement that a result depends on, and only then."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ssm_pipeline.engine import code_digest as digests

SOURCES = {
    "__init__.py": "",
    "loss.py": '"""Losses."""\n\n\ndef loss(x):\n    """Sum."""\n    return x + 1\n',
    "train.py": "def train(x):\n    from toy_project.loss import loss\n\n    return loss(x)\n",
    "page.py": "from toy_project import train\n\n\ndef page(x):\n    return train.train(x)\n",
    "other.py": "def other():\n    return 0\n",
}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "toy_project"
    folder.mkdir()
    for name, source in SOURCES.items():
        (folder / name).write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(digests, "PROJECT", "toy_project")
    yield folder
    for name in [name for name in sys.modules if name.startswith("toy_project")]:
        del sys.modules[name]


def test_imports_are_followed_through_modules_and_functions(project: Path) -> None:
    names = digests.import_closure("toy_project.page")
    assert names == ("toy_project.loss", "toy_project.page", "toy_project.train")


@pytest.mark.parametrize(
    ("file", "old", "new", "changes"),
    [
        ("loss.py", "x + 1", "x + 2", True),  # two imports away, inside a function
        ("train.py", "loss(x)", "2 * loss(x)", True),
        ("loss.py", '"""Sum."""', '"""Another text."""', False),
        ("loss.py", "x + 1", "(x + 1)  # a comment", False),
        ("other.py", "0", "1", False),  # nothing imports it
    ],
)
def test_what_counts(project: Path, file: str, old: str, new: str, changes: bool) -> None:
    before = digests.code_digest("toy_project.page")
    path = project / file
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert (digests.code_digest("toy_project.page") != before) == changes


def test_a_module_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"no module ssm_pipeline\.nothing"):
        digests.code_digest("ssm_pipeline.nothing")


def test_training_depends_on_its_losses_and_not_on_the_report() -> None:
    names = digests.import_closure("ssm_pipeline.training.train")
    assert "ssm_pipeline.interpolation.spatial_loss" in names
    assert not [name for name in names if name.startswith("ssm_pipeline.report")]

"""For every test and for the examples in docstrings, which pytest runs too."""

import pytest


@pytest.fixture(autouse=True)
def examples_run_in_an_empty_folder(request: pytest.FixtureRequest) -> None:
    """So that an example may write `liver.npz` without naming a temporary folder."""
    if isinstance(request.node, pytest.DoctestItem):
        folder = request.getfixturevalue("tmp_path")
        request.getfixturevalue("monkeypatch").chdir(folder)

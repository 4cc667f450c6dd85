"""The notebooks run from first cell to last, and show what they show in the repository."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parents[2] / "notebooks"
FIRST, SECOND, THIRD = (
    "01_masks_to_model.ipynb",
    "02_modes_of_variation.ipynb",
    "03_match_and_interpolate.ipynb",
)


def read(name: str) -> nbformat.NotebookNode:
    notebook: nbformat.NotebookNode = nbformat.read(FOLDER / name, as_version=4)
    return notebook


def execute(name: str, folder: Path) -> nbformat.NotebookNode:
    """The notebook as run anew in `folder`. Raises CellExecutionError where a cell fails."""
    notebook = read(name)
    place = {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=1200, kernel_name="python3", resources=place)
    client.coalesce_streams = True
    return client.execute()


def outputs(notebook: nbformat.NotebookNode) -> list[list[str]]:
    """A row per code cell: the kinds of what it shows."""
    return [
        sorted(kind for out in cell.outputs for kind in out.get("data", {out.get("name"): 0}))
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the notebooks are run in: the second reads what the first leaves."""
    return tmp_path_factory.mktemp("notebooks")


@pytest.fixture(scope="module")
def first(workplace: Path) -> nbformat.NotebookNode:
    return execute(FIRST, workplace)


def test_masks_to_model(first: nbformat.NotebookNode, workplace: Path) -> None:
    assert outputs(first) == outputs(read(FIRST))
    assert (workplace / "runs" / "luna16" / "report" / "index.html").is_file()


@pytest.mark.usefixtures("first")
def test_modes_of_variation_and_its_sliders(workplace: Path) -> None:
    notebook = execute(SECOND, workplace)
    assert outputs(notebook) == outputs(read(SECOND))
    png = [cell for cell in notebook.cells if cell.get("outputs")][-1].outputs[0].data["image/png"]
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    shape = np.asarray(picture, dtype=int)[: int(0.75 * picture.height)]  # without the colour bar
    # The mean is drawn in greys; only a shape that the sliders moved has blue and red on it.
    assert np.abs(shape[..., 0] - shape[..., 2]).max() > 50


def test_match_and_interpolate(tmp_path: Path) -> None:
    notebook = execute(THIRD, tmp_path)
    assert outputs(notebook) == outputs(read(THIRD))
    # On lungs turned by up to 60 degrees the method is to beat rigid alignment, at the worst too.
    (said,) = (
        output.text
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "worst pair" in output.get("text", "")
    )
    rigid, full = (
        [float(word) for word in line.replace("mm", "").split() if word[0].isdigit()]
        for line in said.splitlines()
    )
    assert full[0] < rigid[0]
    assert full[1] < rigid[1]


@pytest.mark.parametrize("name", [FIRST, SECOND, THIRD])
def test_is_kept_with_its_pictures_and_small(name: str) -> None:
    notebook = read(name)
    shown = {kind for kinds in outputs(notebook) for kind in kinds}
    assert "image/png" in shown
    assert "stderr" not in shown  # no warnings kept
    assert (FOLDER / name).stat().st_size < 1_000_000

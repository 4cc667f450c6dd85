"""One way through the rooms: imports point only back along the list, and `--help` stays light."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from source_files import all_modules

ROOT = Path(__file__).parents[1]
ROOMS = (
    "geometry",
    "records",
    "settings",
    "methods",
    "storage",
    "counting",
    "parallel",
    "meshing",
    "data_prep",
    "spectral",
    "cohort_check",
    "matching",
    "interpolation",
    "training",
    "adaptation",
    "shape_model",
    "fitting",
    "baselines",
    "statistics",
    "evaluation",
    "export",
    "report",
    "engine",
    "study",
    "runs",
    "comparison",
    "stages",
    "commands",
    "library",
    "experiments",
    "cli",
    "__main__",
)
# The engine runs stages of anything: it knows files, cases and processes, and no shape.
ENGINE_MAY_USE = {"counting", "parallel", "records", "settings", "storage"}
# data_prep makes what meshing takes, and phantoms and benchmarks are made of geometry.
DATA_PREP_MAY_USE = {"counting", "records", "settings", "storage", "geometry", "meshing"}
MODULES = all_modules()


def room_of(module: str) -> str | None:
    """`ssm_pipeline.geometry.rigid` → `geometry`; None for the package itself and for others."""
    parts = module.split(".")
    return parts[1] if parts[0] == "ssm_pipeline" and len(parts) > 1 else None


def imported(path: Path) -> set[str]:
    """Rooms that a module imports, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path} has a relative import"
            names = [node.module]
            if node.module == "ssm_pipeline":
                names = [f"ssm_pipeline.{alias.name}" for alias in node.names]
        found |= {room for name in names if (room := room_of(name)) is not None}
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_back_along_the_list_of_rooms(path: Path) -> None:
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    room = room_of(module)
    if room is None or module == "ssm_pipeline.__init__":
        return  # the package's front door may lazily show what any room holds
    others = imported(path) - {room}
    assert others <= set(ROOMS), f"rooms that the list does not name: {others - set(ROOMS)}"
    if room == "data_prep":
        assert others <= DATA_PREP_MAY_USE
        return
    if room == "engine":
        assert others <= ENGINE_MAY_USE
        return
    assert room in ROOMS, f"{room} has no place in the list of rooms"
    ahead = {other for other in others if ROOMS.index(other) > ROOMS.index(room)}
    assert not ahead, f"{module} imports {sorted(ahead)}, which come after {room}"


def test_the_check_sees_an_import_that_points_ahead(tmp_path: Path) -> None:
    module = tmp_path / "rigid.py"
    module.write_text("def f():\n    from ssm_pipeline.engine.runner import run_stages\n")
    assert imported(module) == {"engine"}


def test_geometry_and_shape_model_need_no_pytorch() -> None:
    code = "import sys, ssm_pipeline.shape_model.pca; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_run_asks_for_its_team_without_pytorch() -> None:
    code = (
        "import sys\n"
        "from ssm_pipeline.training.team import team_of_torchrun\n"
        "with team_of_torchrun() as team:\n"
        "    assert team.leads and 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_package_and_the_command_line_import_nothing_heavy() -> None:
    code = (
        "import sys, ssm_pipeline, ssm_pipeline.cli\n"
        "heavy = {'numpy', 'torch', 'pandas', 'pydantic', 'vtk', 'SimpleITK'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_contributing_lists_the_rooms_in_their_order() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = text.split("    ssm_pipeline/\n")[1].split("\n\n")[0]
    listed = re.findall(r"^      (\w+)(?:/|\.py)", block, flags=re.MULTILINE)
    inside = [room for room in ROOMS if room not in ("data_prep", "__main__")]
    assert listed == inside
    found = {room_of(".".join(p.relative_to(ROOT).with_suffix("").parts)) for p in MODULES}
    assert found - {None, "__init__"} <= set(ROOMS)

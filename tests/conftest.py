import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for tiny_study


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run, from masks to report, on four small shapes."""
    from tiny_study import run_tiny, write_balls

    folder = tmp_path_factory.mktemp("tiny")
    return run_tiny(write_balls(folder / "masks"), folder / "runs")

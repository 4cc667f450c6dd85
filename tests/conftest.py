import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for tiny_study and command_line
from command_line import Said, Workflow


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run, from masks to report, on four small shapes."""
    from tiny_study import run_tiny, write_balls

    folder = tmp_path_factory.mktemp("tiny")
    return run_tiny(write_balls(folder / "masks"), folder / "runs")


@pytest.fixture
def workflow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Workflow:
    """Call the command as a shell in an empty folder would, without the cost of a process."""
    from ssm_pipeline import cli

    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> Said:
        monkeypatch.setattr(sys, "argv", ["workflow", *words])
        with pytest.raises(SystemExit) as ending:
            cli.main()
        out = capsys.readouterr()
        return Said(int(ending.value.code or 0), out.out, out.err)

    return call

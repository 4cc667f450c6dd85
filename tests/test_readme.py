"""README's Python runs as printed, and its files and commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_there_is_python_in_readme():
    assert PYTHON_BLOCKS


@pytest.mark.parametrize("block", PYTHON_BLOCKS)
def test_python_runs_as_printed(
    block: str,
    tiny_run: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tiny_run.parent.parent)  # holds runs/luna16, as README's reader's folder does
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert "4 cases, 3 modes" in capsys.readouterr().out


def test_links_within_the_repository_lead_somewhere():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_every_command_and_option_named_exists():
    import typer

    from ssm_pipeline import cli

    group = typer.main.get_command(cli.app)
    commands = {**group.commands, **group.commands["benchmark"].commands}
    options = {option for c in commands.values() for p in c.params for option in p.opts}
    for name in set(re.findall(r"`?workflow (\w+)", README)):
        assert name in group.commands, f"workflow {name}"
    lines = [line for line in README.splitlines() if "workflow" in line or "`--" in line]
    for option in set(re.findall(r"(--[a-z]+)\b", "\n".join(lines))):
        assert option in options, option


def test_every_file_that_a_run_is_said_to_leave_is_there(tiny_run: Path):
    block = README.split("runs/luna16/\n")[1].split("\n\n")[0]
    for line in block.splitlines():
        folder, content = line.split(maxsplit=1)
        if not folder.endswith("/"):
            assert (tiny_run / folder).is_file(), folder
            continue
        for name in re.findall(r"[\w<>/-]+\.(?:csv|npz|pt|html)", content):
            pattern = name.replace("<case>", "*").replace("<r>", "*")
            assert list((tiny_run / folder).glob(pattern)), f"{folder}{name}"

"""README's and the documentation's Python runs as printed; their files and commands exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

import ssm_pipeline

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
}
PYTHON_BLOCKS = [
    pytest.param(block, id=f"{page}-{number}")
    for page, text in PAGES.items()
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))
]
OF_A_RUN = [block for block in PYTHON_BLOCKS if "load_run(" in str(block.values[0])]


def test_there_is_python_in_readme_and_the_tutorial() -> None:
    pages = {str(block.id).rsplit("-", 1)[0] for block in PYTHON_BLOCKS}
    assert {"README.md", "docs/how-to/own-organ.md"} <= pages
    assert len(OF_A_RUN) == 2


@pytest.mark.parametrize("block", OF_A_RUN)
def test_python_runs_as_printed(
    block: str,
    tiny_run: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tiny_run.parent.parent)  # holds runs/luna16, as README's reader's folder does
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert "4 cases, 3 modes" in capsys.readouterr().out


@pytest.mark.parametrize("block", PYTHON_BLOCKS)
def test_every_public_name_that_is_printed_exists(block: str) -> None:
    """What takes longer than a test may is run in tests/test_public_names.py, on small shapes."""
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "ssm":
            assert node.attr in ssm_pipeline.__all__, node.attr


@pytest.mark.parametrize("page", PAGES)
def test_links_within_the_repository_lead_somewhere(page: str) -> None:
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", PAGES[page]):
        assert (ROOT / page).parent.joinpath(target).exists(), target


def command_group() -> Any:
    """The commands of `workflow`, as Typer's Click group."""
    import typer

    from ssm_pipeline.cli.app import app

    return typer.main.get_command(app)


@pytest.mark.parametrize("page", PAGES)
def test_every_command_and_option_named_exists(page: str) -> None:
    group = command_group()
    commands = {**group.commands, **group.commands["benchmark"].commands}
    all_commands = [group, *commands.values()]
    options = {option for c in all_commands for p in c.params for option in p.opts}
    for name in set(re.findall(r"(?:^    |`)workflow (\w+)", PAGES[page], flags=re.MULTILINE)):
        assert name in group.commands, f"workflow {name}"
    lines = [line for line in PAGES[page].splitlines() if "workflow" in line or "`--" in line]
    for option in set(re.findall(r"(--[a-z-]+)\b", "\n".join(lines))):
        assert option in options | {"--help"}, option


def test_every_command_is_on_its_page() -> None:
    group = command_group()
    names = [*group.commands.keys() - {"benchmark"}]
    names += [f"benchmark {name}" for name in group.commands["benchmark"].commands]
    for name in names:
        assert f"`workflow {name}" in PAGES["docs/reference/commands.md"], name


def test_every_file_that_a_run_is_said_to_leave_is_there(tiny_run: Path) -> None:
    block = PAGES["docs/reference/formats.md"].split("runs/luna16/\n")[1].split("\n\n")[0]
    for line in block.splitlines():
        folder, content = line.split(maxsplit=1)
        if not folder.endswith("/"):
            assert (tiny_run / folder).is_file(), folder
            continue
        for name in re.findall(r"[\w<>/-]+\.(?:csv|npz|pt|html)", content):
            pattern = name.replace("<case>", "*").replace("<r>", "*")
            assert list((tiny_run / folder).glob(pattern)), f"{folder}{name}"

"""What stands between the code and a Windows or macOS machine, as far as Linux can tell."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from source_files import all_modules

ROOT = Path(__file__).parents[1]
MODULES = all_modules()
ABSENT_ELSEWHERE = ("fcntl", "resource")  # on Windows
# Of os: what Windows or macOS lacks, and what starts processes in a way that they do not.
OF_LINUX = {"sysconf", "uname", "fork", "getuid", "geteuid", "mkfifo", "sched_getaffinity"}


def names_of_modules() -> list[str]:
    parts = (path.relative_to(ROOT).with_suffix("").parts for path in MODULES)
    return [".".join(p).removesuffix(".__init__") for p in parts if p[-1] != "__main__"]


WITHOUT_THEM = """
import builtins, importlib, sys

real = builtins.__import__

def absent(name, globals=None, *rest, **words):
    # Other packages choose by the platform, which is Linux here.
    ours = (globals or {}).get("__name__", "").split(".")[0] == "ssm_pipeline"
    if ours and name in MODULES_ABSENT:
        raise ModuleNotFoundError(name)
    return real(name, globals, *rest, **words)

builtins.__import__ = absent
"""


def test_every_module_is_imported_where_two_of_linux_are_not_to_be_had() -> None:
    code = (
        f"MODULES_ABSENT = {ABSENT_ELSEWHERE!r}\n{WITHOUT_THEM}"
        f"for name in {names_of_modules()!r}: importlib.import_module(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_only_linux_has_is_asked_for_first(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            assert not {alias.name for alias in node.names} & set(ABSENT_ELSEWHERE)
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "os":
            guarded = f'hasattr(os, "{node.attr}")' in source
            assert node.attr not in OF_LINUX or guarded, f"os.{node.attr}"


def test_text_files_are_read_and_written_as_utf_8_everywhere() -> None:
    """Windows' own default is another one."""
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            ours = getattr(node.func.value, "id", "") == "storage"  # which writes UTF-8
            if node.func.attr in ("read_text", "write_text") and not ours:
                said = {keyword.arg for keyword in node.keywords}
                assert "encoding" in said, f"{path}:{node.lineno}"


def test_every_benchmark_finds_what_it_imports() -> None:
    """They are run by hand, so nothing else notices a name that moved."""
    code = (
        "import runpy, sys\nsys.path.insert(0, 'benchmarks')\n"
        "for path in sys.argv[1:]:\n"
        "    runpy.run_path(path, run_name='not_main')\n"
    )
    paths = [str(path) for path in sorted((ROOT / "benchmarks").glob("*.py"))]
    assert paths
    done = subprocess.run(
        [sys.executable, "-c", code, *paths], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr[-2000:]

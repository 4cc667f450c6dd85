"""What the code imports is what the package asks for; what it ships is there."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import yaml
from source_files import all_modules

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MODULES = all_modules()
OURS = {"ssm_pipeline"}


def plain(name: str) -> str:
    return name.lower().replace("_", "-")


def names(requirements: list[str]) -> set[str]:
    return {plain(re.split(r"[\[<>=~! ]", line)[0]) for line in requirements}


def imported() -> set[str]:
    """Top-level names of all modules that the packages import, wherever in their code."""
    found: set[str] = set()
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - OURS


def distributions(modules: set[str]) -> dict[str, set[str]]:
    """Module → the distributions that bring it, written one way."""
    known = importlib.metadata.packages_distributions()
    return {module: {plain(name) for name in known.get(module, [])} for module in modules}


def test_all_that_is_imported_is_asked_for() -> None:
    extras = PROJECT["optional-dependencies"]
    of_users = [extras[name] for name in extras if name not in ("dev", "docs", "notebooks")]
    asked = names(PROJECT["dependencies"] + [line for extra in of_users for line in extra])
    missing = {m: d for m, d in distributions(imported()).items() if d and not d & asked}
    assert not missing, missing


def test_all_that_is_asked_for_is_imported() -> None:
    brought = set().union(*distributions(imported()).values())
    assert not names(PROJECT["dependencies"]) - brought


def test_the_image_holds_the_system_packages_that_make_installs() -> None:
    wanted = re.search(r"^SYSTEM_PACKAGES := (.*)$", text_of("Makefile"), flags=re.MULTILINE)
    installed = re.search(r"apt-get install (.*?)&&", text_of("Dockerfile"), flags=re.DOTALL)
    assert wanted is not None
    assert installed is not None
    assert set(wanted[1].split()) <= set(installed[1].split())


def test_the_citation_names_the_version_of_the_package() -> None:
    citation = yaml.safe_load(text_of("CITATION.cff"))
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_constraints_hold_a_version_of_each() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = names([line for line in lines if "==" in line])
    extras = [line for extra in PROJECT["optional-dependencies"].values() for line in extra]
    wanted = names(PROJECT["dependencies"] + extras) - {"ssm-pipeline"}
    assert not wanted - pinned, sorted(wanted - pinned)

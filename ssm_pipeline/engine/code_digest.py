"""Digest the code that computes a result, so that cached results of other code are not reused.

The digest covers a module and every module of the project that it imports, directly or through
others, inside functions too. Comments, docstrings and formatting do not count.
"""

from __future__ import annotations

import ast
import hashlib
from importlib.util import find_spec
from pathlib import Path

PROJECT = __name__.partition(".")[0]


def code_digest(*modules: str) -> str:
    """Digest the code of modules and of everything in the project that they import.

    Args:
        modules: Full names, such as `ssm_pipeline.training.train`.

    Returns:
        A hash that changes when any statement of any of these modules changes.

    Raises:
        ModuleNotFoundError: A module does not exist.

    >>> code_digest("ssm_pipeline.geometry.rigid") == code_digest("ssm_pipeline.geometry.rigid")
    True
    >>> code_digest("ssm_pipeline.geometry.rigid") == code_digest("ssm_pipeline.geometry.affine")
    False
    """
    digest = hashlib.blake2b(digest_size=16)
    for name in import_closure(*modules):
        digest.update(name.encode())
        digest.update(_statements(_source(name)).encode())
    return digest.hexdigest()


def import_closure(*modules: str) -> tuple[str, ...]:
    """Return the modules and all modules of the project that they import, sorted by name.

    >>> "ssm_pipeline.geometry.similarity" in import_closure("ssm_pipeline.geometry.rigid")
    True
    """
    found: set[str] = set()
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting.extend(_imports(_source(name)))
    return tuple(sorted(found))


def _source(module: str) -> Path:
    path = _file_of(module)
    if path is None:
        raise ModuleNotFoundError(f"there is no module {module}")
    return path


def _file_of(module: str) -> Path | None:
    """Return the module's file, or None if there is no such module. Nothing is imported."""
    package = find_spec(PROJECT)
    assert package is not None
    assert package.origin is not None
    path = Path(package.origin).parent.joinpath(*module.split(".")[1:])
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imports(path: Path) -> set[str]:
    """Return the project's modules that a file imports, without the package itself."""
    names: set[str] = set()
    for node in ast.walk(_parsed(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module)
            # `from package import module` imports the module, too.
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    ours = {name for name in names if name.startswith(f"{PROJECT}.")}
    return {name for name in ours if _file_of(name) is not None}


def _statements(path: Path) -> str:
    """Return the syntax tree as text, without docstrings and positions."""
    return ast.dump(_WithoutDocstrings().visit(_parsed(path)))


class _WithoutDocstrings(ast.NodeTransformer):
    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                statement
                for statement in body
                if not (
                    isinstance(statement, ast.Expr)
                    and isinstance(statement.value, ast.Constant)
                    and isinstance(statement.value.value, str)
                )
            ]
        return node

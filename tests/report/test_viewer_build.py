"""viewer.js is what its sources build; checked by what its build wrote down, without Node."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

VIEWER = Path(__file__).parents[2] / "ssm_pipeline" / "report" / "viewer"
ADVICE = "in ssm_pipeline/report/viewer: npm ci && npm run build"


def digest_of_sources(folder: Path) -> str:
    """As build.mjs takes it: names and contents, in the order of the names."""
    names = [path.relative_to(folder).as_posix() for path in (folder / "src").rglob("*.js")]
    digest = hashlib.sha256()
    for name in sorted([*names, "package-lock.json"]):
        digest.update(name.encode() + (folder / name).read_bytes())
    return digest.hexdigest()


def test_the_viewer_is_what_its_sources_build() -> None:
    built = json.loads((VIEWER / "viewer.built.json").read_text(encoding="utf-8"))
    assert digest_of_sources(VIEWER) == built["sources"], f"a source changed since; {ADVICE}"
    viewer = hashlib.sha256((VIEWER / "viewer.js").read_bytes()).hexdigest()
    assert viewer == built["viewer"], f"viewer.js was changed by hand; {ADVICE}"


def test_a_changed_source_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    for name in ("src/main.js", "package-lock.json"):
        (tmp_path / name).write_bytes(b"1")
    before = digest_of_sources(tmp_path)
    (tmp_path / "src/main.js").write_bytes(b"2")
    assert digest_of_sources(tmp_path) != before

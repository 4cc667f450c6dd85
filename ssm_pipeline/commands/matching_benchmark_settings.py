"""Settings of `workflow benchmark matching`, and its presets."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from pydantic import Field

from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.methods import PairMethod
from ssm_pipeline.records import StudyError
from ssm_pipeline.settings import Settings
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.study.yaml_settings import checked_as, merge, parse_change, read_yaml
from ssm_pipeline.training.settings import TrainingSettings


class MatchingBenchmarkSettings(Settings):
    """What is trained and tested. `training.faces` is not used: shapes are taken as they come."""

    seed: int = Field(0, ge=0)  # of every random draw
    spectral: SpectralSettings = SpectralSettings()
    training: TrainingSettings = TrainingSettings()
    adaptation: AdaptationSettings = AdaptationSettings()
    method: PairMethod = "full"  # full, or one of its ablations


def read_preset(name: str, changes: Sequence[str] = ()) -> MatchingBenchmarkSettings:
    """A preset by name, or a YAML's path, with `--set` changes. Raises StudyError."""
    path = Path(name) if name.endswith((".yaml", ".yml")) else _presets().get(name)
    if path is None or not path.is_file():
        raise StudyError(f"there is no preset {name}; known: {', '.join(_presets())}.")
    content = functools.reduce(merge, map(parse_change, changes), read_yaml(path))
    return checked_as(MatchingBenchmarkSettings, content, path)


def parse_range(option: str, text: str | None) -> range | None:
    """`80:100` → range(80, 100). Raises StudyError."""
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    if not (colon and start.isdigit() and stop.isdigit() and int(start) < int(stop)):
        raise StudyError(f"{option} {text}: a range such as 80:100 is needed, its end left out.")
    return range(int(start), int(stop))


def _presets() -> dict[str, Path]:
    package = Path(str(files("ssm_pipeline")))
    found: dict[str, Path] = {}
    for folder in (package / "workflows", package.parent / "workflows"):
        for path in sorted((folder / "benchmarks").glob("*.yaml")):
            found.setdefault(path.stem, path)
    return found

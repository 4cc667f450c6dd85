"""Settings of `workflow benchmark matching`, and its presets."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.data_prep.synthetic.articulated_settings import ArticulatedSettings
from ssm_pipeline.methods import METHODS, base_methods, method_named
from ssm_pipeline.records import StudyError
from ssm_pipeline.settings import Settings
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.study.yaml_settings import checked_as, merge, parse_changes, read_yaml
from ssm_pipeline.training.settings import TrainingSettings

BUILT_IN = (
    "articulated",
    "articulated-shapes",
    "articulated-merged",
)  # each with a preset of its name
PairMethod = Annotated[
    str, AfterValidator(lambda name: method_named(name, base_methods("pair")).id)
]
# Methods that read the study's network, and what adaptation reaches without one. The others train
# a network of their own or assume shapes in one pose; --methods adds them.
DEFAULT_METHODS: tuple[str, ...] = tuple(
    method.id
    for method in METHODS
    if method.id in base_methods("pair")
    and (method.network == "study" or method.id == "adaptation only")
)


class MatchingBenchmarkSettings(Settings):
    """What is trained and tested. Shapes are tested as they are; training uses coarser ones."""

    seed: int = Field(0, ge=0)  # of every random draw
    spectral: SpectralSettings = SpectralSettings()
    training: TrainingSettings = TrainingSettings()
    adaptation: AdaptationSettings = AdaptationSettings()
    methods: tuple[PairMethod, ...] = Field(DEFAULT_METHODS, min_length=1)  # a row each
    train: str = ""  # shapes, as 0:80, train_cat.txt or dog,fox; empty: all
    test: str = ""  # the same
    leave_out: tuple[str, ...] = ()  # shapes or categories, by name
    between: Literal["all", "within categories", "between categories"] = "all"  # pairs counted
    self_pairs: bool = False  # count a shape's map to itself, as the literature's code does
    interpolations: int = Field(3, ge=0)  # pairs interpolated and measured, where `full` is a row
    built_in: ArticulatedSettings = ArticulatedSettings()  # only of --built-in shapes


def preset_for(data: Path | None, built_in: str | None, preset: str | None) -> str:
    """The name of the preset.

    Raises:
        StudyError: Unless either data or built-in shapes are given.

    >>> preset_for(None, "articulated", None), preset_for(Path("FAUST_r"), None, None)
    ('articulated', 'non-isometric')
    """
    if (data is None) == (built_in is None):
        raise StudyError(
            f"give either --data FOLDER or --built-in {' or '.join(BUILT_IN)}, one of them."
        )
    if built_in is not None and built_in not in BUILT_IN:
        raise StudyError(f"--built-in {built_in}: the built-in shapes are {', '.join(BUILT_IN)}.")
    return preset or built_in or "non-isometric"


def read_preset(
    name: str, changes: Sequence[str] = (), options: Mapping[str, object] | None = None
) -> MatchingBenchmarkSettings:
    """The settings of a preset, changed first by `--set` and then by the options that are not None.

    Args:
        name: Of a preset, or the path of a YAML file.

    Raises:
        StudyError: There is no such preset, or it does not hold such settings.
    """
    path = Path(name) if name.endswith((".yaml", ".yml")) else _presets().get(name)
    if path is None or not path.is_file():
        raise StudyError(f"there is no preset {name}; known: {', '.join(_presets())}.")
    given = {name: value for name, value in (options or {}).items() if value is not None}
    over = [*parse_changes(changes), given]
    content = functools.reduce(merge, over, read_yaml(path))
    return checked_as(MatchingBenchmarkSettings, content, path)


def folder_of_benchmark(name: str, preset: str | None) -> str:
    """The folder of a benchmark: presets of one data set do not share a folder.

    >>> folder_of_benchmark("DT4D_r", "dt4d-inter"), folder_of_benchmark("articulated", None)
    ('matching-DT4D_r-dt4d-inter', 'matching-articulated')
    """
    own = "" if preset is None else f"-{Path(preset).stem}"
    return f"matching-{name}{own}"


def changes_from_preset(preset: str, settings: MatchingBenchmarkSettings) -> str:
    """How settings differ from their preset; the list of methods does not count.

    >>> settings = read_preset("faust", ["training.steps=300", "seed=1"])
    >>> changes_from_preset("faust", settings)
    'seed=1, training.steps=300'
    """
    before, after = (_flat(one.model_dump(mode="json")) for one in (read_preset(preset), settings))
    changed = {key: value for key, value in after.items() if before.get(key) != value}
    return ", ".join(f"{key}={value}" for key, value in changed.items() if key != "methods")


def _flat(content: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _presets() -> dict[str, Path]:
    package = Path(str(files("ssm_pipeline")))
    found: dict[str, Path] = {}
    for folder in (package / "workflows", package.parent / "workflows"):
        for path in sorted((folder / "benchmarks").glob("*.yaml")):
            found.setdefault(path.stem, path)
    return found

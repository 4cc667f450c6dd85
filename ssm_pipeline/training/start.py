"""The weights that training starts from, unless they are fresh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ssm_pipeline.records import DamagedFile, SpectralBasis, StudyError
from ssm_pipeline.training.matcher import Matcher, load_matcher
from ssm_pipeline.training.settings import TrainingSettings


def starting_weights(
    settings: TrainingSettings, bases: Sequence[SpectralBasis], device: str = "cpu"
) -> Matcher | None:
    """The matcher that `settings.start` names; None for fresh weights.

    Raises:
        StudyError: Where its networks are of another size or read other inputs than `settings` and
            `bases` say.
    """
    path = settings.start_file
    if path is None:
        return None
    matcher = _loaded(path, settings, device)
    eigenpairs = len(bases[0].eigenvalues)
    if matcher.eigenpairs != eigenpairs:
        raise StudyError(
            f"training.start: {settings.start} was trained with {matcher.eigenpairs} eigenpairs, "
            f"these shapes have {eigenpairs}, which changes every network input. Set "
            f"spectral.eigenpairs={matcher.eigenpairs}, or training.start=none."
        )
    return matcher


def refuse_other_networks(settings: TrainingSettings) -> None:
    """Check starting weights against the settings, before anything is computed.

    Raises:
        StudyError: For weights that are missing, or whose networks differ from the settings.
    """
    path = settings.start_file
    if path is not None:
        _loaded(path, settings, "cpu")


def _loaded(path: Path, settings: TrainingSettings, device: str) -> Matcher:
    if not path.is_file():
        raise StudyError(f"training.start: {path} is no file. Give a matcher.pt, built-in or none.")
    try:
        matcher = load_matcher(path, device)
    except DamagedFile as error:
        raise StudyError(f"training.start: {error}. Give a matcher.pt of a run.") from error
    theirs, ours = _architecture(matcher.settings), _architecture(settings)
    unlike = [name for name in ours if theirs[name] != ours[name]]
    if unlike:
        other = [f"{name}={theirs[name]}, not {ours[name]}" for name in unlike]
        raise StudyError(
            f"training.start: the networks of {settings.start} have {', '.join(other)}. Set these "
            "as they are there, or training.start=none."
        )
    return matcher


def _architecture(settings: TrainingSettings) -> dict[str, object]:
    """What decides the shapes and the meaning of the weights."""
    matching = settings.matching
    names = ("features", "descriptors", "channels", "width", "blocks", "normalise")
    found: dict[str, object] = {f"matching.{name}": getattr(matching, name) for name in names}
    return found | {
        f"interpolation.{name}": value
        for name, value in settings.interpolation.model_dump().items()
    }

from pathlib import Path
from typing import Any

import pytest
import torch
from shapes import basis_of, blob

from ssm_pipeline.data_prep.formats.surface_files import read_mesh
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.fit_to_cohort import refuse_what_cannot_fit
from ssm_pipeline.training.checkpoint import TrainingCheckpoint
from ssm_pipeline.training.matcher import load_matcher
from ssm_pipeline.training.settings import BUILT_IN_EIGENPAIRS, TrainingSettings
from ssm_pipeline.training.start import refuse_other_networks, starting_weights
from ssm_pipeline.training.train import train_networks

SPLEENS = Path(__file__).parents[3] / "shared" / "data" / "msd_spleen_surfaces"
SMALL = TrainingSettings(
    steps=3,
    matching=MatchingSettings(features="wks", descriptors=16, channels=8, width=16, blocks=2),
)


@pytest.fixture(scope="module")
def bases() -> Any:
    return [basis_of(blob(index)) for index in (1, 2, 3)]


@pytest.fixture(scope="module")
def trained(bases: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    matcher = train_networks(bases, SMALL, seed=4)
    path = tmp_path_factory.mktemp("start") / "matcher.pt"
    matcher.save(path)
    return matcher, path


def test_no_steps_leave_the_weights_as_they_start(bases: Any, trained: Any) -> None:
    matcher, path = trained
    same = train_networks(bases, SMALL.model_copy(update={"start": str(path), "steps": 0}), seed=9)
    shape = matcher.shape(bases[0])
    assert torch.equal(matcher.features(shape), same.features(shape))


def test_steps_from_given_weights_begin_where_those_ended(bases: Any, trained: Any) -> None:
    _, path = trained
    fresh, started = [], []
    go_on = SMALL.model_copy(update={"start": str(path)})
    train_networks(bases, SMALL, seed=4, on_step=lambda step, losses: fresh.append(losses["total"]))
    train_networks(
        bases, go_on, seed=4, on_step=lambda step, losses: started.append(losses["total"])
    )
    assert started[0] != fresh[0]
    weights = [train_networks(bases, settings, seed=4) for settings in (SMALL, go_on)]
    assert not torch.equal(*(next(matcher.networks.parameters()) for matcher in weights))


def test_training_that_goes_on_does_not_read_its_start_again(
    bases: Any, trained: Any, tmp_path: Path
) -> None:
    """The weights stand in the checkpoint; the file that training began from may be gone."""
    _, path = trained
    begun = tmp_path / "matcher.pt"
    begun.write_bytes(path.read_bytes())
    settings = SMALL.model_copy(update={"start": str(begun), "checkpoint_every": 2})
    checkpoints: list[TrainingCheckpoint] = []
    whole = train_networks(bases, settings, seed=4, on_checkpoint=checkpoints.append)
    begun.unlink()
    resumed = train_networks(bases, settings, seed=4, start=checkpoints[0])
    shape = whole.shape(bases[0])
    assert torch.equal(whole.features(shape), resumed.features(shape))


def test_a_matcher_has_seen_the_shapes_of_its_starting_weights_too(
    bases: Any, trained: Any
) -> None:
    _, path = trained
    new = [basis_of(blob(index)) for index in (3, 4)]  # blob3 twice: once in the list
    settings = SMALL.model_copy(update={"start": str(path), "checkpoint_every": 2})
    checkpoints: list[TrainingCheckpoint] = []
    matcher = train_networks(new, settings, seed=4, on_checkpoint=checkpoints.append)
    assert matcher.trained_on == ("blob1", "blob2", "blob3", "blob4")
    resumed = train_networks(new, settings, seed=4, start=checkpoints[0])
    assert resumed.trained_on == matcher.trained_on


def test_packed_weights_are_smaller_and_nearly_the_same(
    bases: Any, trained: Any, tmp_path: Path
) -> None:
    matcher, path = trained
    matcher.save(tmp_path / "packed.pt", packed=True)
    assert (tmp_path / "packed.pt").stat().st_size < 0.7 * path.stat().st_size
    shape = matcher.shape(bases[0])
    difference = load_matcher(tmp_path / "packed.pt").features(shape) - matcher.features(shape)
    assert difference.square().mean().sqrt() < 0.03  # features have a standard deviation of 1


@pytest.mark.parametrize("features", ["wks", "xyz+wks"])
def test_the_built_in_weights_fit_the_default_networks(features: str) -> None:
    settings = TrainingSettings(start="built-in", matching=MatchingSettings(features=features))
    refuse_other_networks(settings)
    assert settings.start_file is not None
    assert load_matcher(settings.start_file).eigenpairs == BUILT_IN_EIGENPAIRS


def test_the_built_in_weights_match_shapes_never_seen() -> None:
    """Without a step on them: the map is sharp, and carries a shape to itself."""
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.spectral.settings import SpectralSettings
    from ssm_pipeline.training.template_choice import choose_template

    spectral = SpectralSettings(eigenpairs=BUILT_IN_EIGENPAIRS)
    bases = [spectral_basis(blob(seed, faces=1000), spectral) for seed in (1, 2)]
    matcher = train_networks(bases, TrainingSettings(start="built-in", steps=0), seed=0)
    _, table = choose_template(matcher, bases)
    assert (table["map_extent"] > 0.9).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": "no/such/matcher.pt"}, "is no file. Give a matcher.pt"),
        ({"start": "built-in"}, "have matching.descriptors=128, not 16"),
    ],
)
def test_what_cannot_be_started_from_is_said(change: Any, said: str) -> None:
    with pytest.raises(StudyError, match=said):
        refuse_other_networks(SMALL.model_copy(update=change))


def test_a_file_that_is_no_matcher_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "matcher.pt"
    path.write_bytes(b"no matcher")
    with pytest.raises(StudyError, match=r"damaged.*Give a matcher\.pt of a run"):
        refuse_other_networks(SMALL.model_copy(update={"start": str(path)}))


def test_weights_of_other_eigenpairs_are_refused(bases: Any, trained: Any) -> None:
    _, path = trained
    more = [basis_of(blob(index), eigenpairs=30) for index in (1, 2)]
    with pytest.raises(StudyError, match="these shapes have 30, which changes every network input"):
        starting_weights(SMALL.model_copy(update={"start": str(path)}), more)
    with pytest.raises(StudyError, match=r"Set spectral\.eigenpairs="):
        load_matcher(path).shape(more[0])


def test_no_steps_from_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match=r"steps is 0 and training\.start none"):
        TrainingSettings(steps=0)


def test_a_study_hears_it_before_the_hours() -> None:
    from ssm_pipeline.records import Cohort
    from ssm_pipeline.study.study import read_study

    with pytest.raises(StudyError, match=r"spectral\.eigenpairs is 100"):
        read_study("phantoms", None, ["training.start=built-in", "spectral.eigenpairs=100"])
    study = read_study("phantoms", None, ["training.start=nowhere.pt"])
    with pytest.raises(StudyError, match=r"nowhere\.pt is no file"):
        refuse_what_cannot_fit(study.settings, Cohort("phantoms", ()))


@pytest.mark.skipif(not SPLEENS.is_dir(), reason="../shared/data/msd_spleen_surfaces is not here")
def test_the_built_in_weights_match_organs_of_another_anatomy() -> None:
    """The first ones gave 0.54 here: they knew the anatomies they were trained on, and no other."""
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.spectral.settings import SpectralSettings
    from ssm_pipeline.training.template_choice import choose_template

    settings = TrainingSettings(
        start="built-in", steps=0, matching=MatchingSettings(features="xyz+wks")
    )
    spectral = SpectralSettings(eigenpairs=BUILT_IN_EIGENPAIRS)
    surfaces = [read_mesh(path) for path in sorted(SPLEENS.glob("*.ply"))[:4]]
    bases = [spectral_basis(decimate(mesh, settings.faces), spectral) for mesh in surfaces]
    _, table = choose_template(train_networks(bases, settings, seed=0), bases)
    assert (table["map_extent"] > 0.9).all()

"""`workflow pretrain`: the built-in weights made again, here on four small shapes."""

from pathlib import Path
from typing import Literal

import pytest
from shapes import blob

import ssm_pipeline.data_prep.synthetic.pretraining
from ssm_pipeline.data_prep.synthetic.articulated_settings import DEVELOPMENT_SEED, REPORTED_SEED
from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT, REPORTED
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.pretrain import pretrain, pretraining_settings
from ssm_pipeline.training.matcher import load_matcher
from ssm_pipeline.training.settings import BUILT_IN_EIGENPAIRS, TrainingSettings
from ssm_pipeline.training.start import refuse_other_networks


@pytest.mark.parametrize("features", ["wks", "xyz+wks"])
def test_what_it_writes_can_be_started_from(
    features: Literal["wks", "xyz+wks"], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes = [blob(seed, faces=1000) for seed in (1, 2, 3, 4)]
    families = ["a", "a", "b", "b"]
    drawn = (shapes, families)
    monkeypatch.setattr(
        ssm_pipeline.data_prep.synthetic.pretraining, "pretraining_shapes", lambda features: drawn
    )
    path = tmp_path / "weights" / "matcher.pt"
    pretrain(features, 2, path, "cpu", Terminal())
    matcher = load_matcher(path)
    assert matcher.eigenpairs == BUILT_IN_EIGENPAIRS
    assert len(matcher.trained_on) == 4
    start = TrainingSettings(
        start=str(path), matching=pretraining_settings(features, 2).matching, steps=0
    )
    refuse_other_networks(start)


def test_its_seed_neither_chooses_settings_nor_is_reported() -> None:
    others = {*DEVELOPMENT, *REPORTED, DEVELOPMENT_SEED, REPORTED_SEED}
    assert ssm_pipeline.data_prep.synthetic.pretraining.SEED not in others


def test_coordinates_are_turned_in_any_common_direction() -> None:
    assert pretraining_settings("xyz+wks", 5).turn_together
    assert not pretraining_settings("wks", 5).turn_together

"""`workflow pretrain`: weights for `training.start`, from synthetic shapes only."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.training.settings import BUILT_IN_EIGENPAIRS, TrainingSettings


def pretraining_settings(features: Literal["wks", "xyz+wks"], steps: int) -> TrainingSettings:
    """The settings with which a study trains on its organs.

    If the features include coordinates, shapes are also rotated. Two scans of one organ have nearly
    the same orientation, to about 20 degrees, but this orientation is not known in advance. So both
    shapes of a pair are rotated together by any angle, and then each by up to 20 degrees.
    """
    matching = MatchingSettings(features=features)
    if features == "wks":
        return TrainingSettings(steps=steps, matching=matching)
    return TrainingSettings(
        steps=steps, matching=matching, turn_together=True, turn_deg=20.0, jitter=0.02
    )


def pretrain(
    features: Literal["wks", "xyz+wks"], steps: int, to: Path, device: str, terminal: Terminal
) -> None:
    """Train on the shapes of `synthetic.pretraining` and write the matcher to `to`."""
    from ssm_pipeline.data_prep.synthetic.pretraining import SEED, pretraining_shapes
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.spectral.settings import SpectralSettings
    from ssm_pipeline.training.train import train_networks

    settings = pretraining_settings(features, steps)
    terminal.say("drawing the shapes …")
    meshes, families = pretraining_shapes(features)
    spectral = SpectralSettings(eigenpairs=BUILT_IN_EIGENPAIRS)
    bases = []
    with terminal.steps("spectral bases", len(meshes)) as progress:
        for mesh in meshes:
            bases.append(spectral_basis(decimate(mesh, settings.faces), spectral))
            progress.advance_to(len(bases))
    with terminal.steps("training", steps) as progress:
        matcher = train_networks(
            bases,
            settings,
            SEED,
            device,
            families=families,
            on_step=lambda step, losses: progress.advance_to(step, f"loss {losses['total']:.3g}"),
        )
    to.parent.mkdir(parents=True, exist_ok=True)
    matcher.save(to, packed=True)
    terminal.say(f"{to}: {to.stat().st_size / 2**20:.1f} MB")

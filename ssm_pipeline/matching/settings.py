"""Settings of the matching networks and the spectral loss."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings

# Of Y's extent: a soft map narrower than this carries every point towards the middle.
COLLAPSED_EXTENT = 0.5

InferenceMap = Literal["projected", "features", "soft"]


class MatchingSettings(Settings):
    # Network input: the wave kernel signature, and the coordinates of shapes that lie alike. The
    # paper, and shapes in any position: wks.
    features: Literal["wks", "xyz+wks"] = "xyz+wks"
    descriptors: int = Field(128, ge=2)  # dimensions of the wave kernel signature
    channels: int = Field(256, ge=1)  # features a vertex; the paper: 256, near-isometric 384
    width: int = Field(128, ge=1)  # hidden channels of DiffusionNet
    blocks: int = Field(4, ge=1)  # DiffusionNet blocks
    dropout: float = Field(0.0, ge=0, lt=1)  # in the blocks' MLPs; the authors' code: 0.5
    # Each shape's features have mean 0 and variance 1 in every channel, by area. Neither the paper
    # nor its code does; without it all features point the same way and the soft map is uniform.
    normalise: bool = True
    temperature: float = Field(0.07, gt=0)  # τ of the soft map, features of length 1
    resolvent_weight: float = Field(100.0, ge=0)  # λ of the functional map
    resolvent_gamma: float = Field(0.5, gt=0)  # γ of the resolvent mask
    block_rows: int = Field(1024, ge=1)  # rows of the soft map held at a time
    # What carries Y to X once trained: nearest features, these projected on the eigenbasis, or the
    # soft map, as printed, whose averages end inside the shape. The authors' code: projected for
    # near-isometric shapes, features for others.
    inference_map: InferenceMap = "projected"


class SpectralLossWeights(Settings):
    bijectivity: float = Field(1.0, ge=0)  # λ_bij
    orthogonality: float = Field(1.0, ge=0)  # λ_orth
    coupling: float = Field(1.0, ge=0)  # λ_couple

"""Settings of test-time adaptation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ssm_pipeline.settings import Settings


class AdaptationSettings(Settings):
    """How a template is adapted to a case, once its pose is known."""

    # Dirichlet energy against Chamfer, both in squared lengths at unit area: minimise
    # CD + stiffness · trace(ΔᵀLΔ). The authors' code effectively uses 0.0033 / 50 = 6.6e-5; the
    # printed 0.1 hardly lets the surface move.
    stiffness: float = Field(3e-4, gt=0)
    samples: int = Field(40_000, ge=100)  # points on each surface
    steps: int = Field(10, ge=1)  # Gauss–Newton steps
    tangential: float = Field(0.005, gt=0, le=1)  # weight of sliding against the normal's 1
    # μ of a pull towards the map, μ Σ_i A_i c_i ‖x_i + Δ_i − (Π_xy Y)_i‖², c_i from the cycle's
    # error; in the paper adaptation hears the map through X(1) alone: 0.
    map_weight: float = Field(0.0, ge=0)
    cycle_scale: float = Field(0.05, gt=0)  # √area; a vertex whose cycle ends so far off: c = 0.6
    # Where adaptation starts. map: at the pose of the map (`starts_from_map`). network: at the
    # network's pose, as in the paper.
    starts: Literal["map", "network"] = "map"
    # μ of the pose of the map, per area: noise is smoothed over √(2 / μ), 0.32 and 0.18 √area.
    # A further weight stands for a further round: the nearest points of the pose make a new map.
    start_map_weights: tuple[Annotated[float, Field(gt=0)], ...] = Field((20.0, 60.0), min_length=1)
    # √area; a map that bends the template by less on average gives a rotation only.
    rigid_below: float = Field(0.05, ge=0)
    # √area; a map that bends the template is trusted where its cycle error is at most this.
    trusted_cycle: float = Field(0.03, ge=0)
    # A start by closest points that contradicts the map is kept only if it ends with so much less
    # of distance and distortion: where both reach the case, a few percent do not tell which is
    # right.
    start_margin: float = Field(0.25, ge=0, lt=1)
    path_times: int = Field(5, ge=2)  # times at which a path is adapted, 0 and 1 included

"""How long a matching benchmark will take on this machine, from a few steps and one pair."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ssm_pipeline.engine.terminal import duration
from ssm_pipeline.methods import method_named
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.settings import AdaptationSettings
    from ssm_pipeline.training.matcher import Matcher


def seconds_a_step(
    x: SpectralBasis, y: SpectralBasis, settings: TrainingSettings, device: str
) -> tuple[float, Matcher]:
    """The mean over the schedule, and the matcher of the trial, which is practically untrained.

    The time of a step is linear in the number of time steps T, so the fewest and the most are
    measured.
    """
    from ssm_pipeline.training.train import train_networks

    tried: dict[int, float] = {}
    for time_steps in {min(settings.time_steps), max(settings.time_steps)}:
        trial = settings.model_copy(
            update={"steps": 3, "time_steps": (time_steps,), "time_step_shares": (1.0,)}
        )
        stamps: list[float] = []

        def on_step(step: int, losses: dict[str, float], stamps: list[float] = stamps) -> None:
            stamps.append(time.perf_counter())

        matcher = train_networks([x, y], trial, seed=0, device=device, on_step=on_step)
        tried[time_steps] = stamps[1] - stamps[0]  # the first step warms up, the last does more
    fewest, most = min(tried), max(tried)
    slope = (tried[most] - tried[fewest]) / max(most - fewest, 1)
    at_each = (tried[fewest] + slope * (count - fewest) for count in settings.time_steps)
    shares = settings.time_step_shares
    return sum(share * s for share, s in zip(shares, at_each, strict=True)), matcher


def seconds_a_pair(
    x: SpectralBasis,
    y: SpectralBasis,
    matcher: Matcher,
    settings: AdaptationSettings,
    methods: Sequence[str],
) -> dict[str, float]:
    """The time of one match by each method, which does not depend on the matcher's training."""
    from ssm_pipeline.adaptation.correspond import correspond_bases

    taken: dict[str, float] = {}
    for method in methods:
        start = time.perf_counter()
        needed = matcher if method_named(method).uses_network else None
        correspond_bases(y, x, needed, settings, method)
        taken[method] = time.perf_counter() - start
    return taken


def cost_in_words(
    trainings: int, steps: int, step_s: float, pairs: Mapping[str, int], pair_s: Mapping[str, float]
) -> str:
    """`about 12 min here: training, 500 steps of 1.2 s, 10 min; full, 90 pairs of 1.3 s, 2 min`.

    >>> cost_in_words(1, 500, 1.2, {"full": 90}, {"full": 2.0})
    'about 13 min 0 s here: training, 500 steps of 1.2 s, 10 min 0 s; full, 90 pairs of 2.0 s, ...'
    """
    total, parts = 0.0, []
    for _ in range(trainings):
        seconds = steps * step_s
        total += seconds
        parts.append(f"training, {steps} steps of {duration(step_s)}, {duration(seconds)}")
    for method, count in pairs.items():
        if count:
            seconds = count * pair_s[method]
            total += seconds
            each = duration(pair_s[method])
            parts.append(f"{method}, {count} pairs of {each}, {duration(seconds)}")
    return f"about {duration(total)} here: " + "; ".join(parts)

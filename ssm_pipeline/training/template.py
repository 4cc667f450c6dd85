"""The choice of the template."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch

from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import Matcher


@torch.no_grad()
def choose_template(matcher: Matcher, bases: Sequence[SpectralBasis]) -> tuple[str, pd.DataFrame]:
    """The training shape whose mean loss to the others is smallest.

    Each candidate is tried on `template_pairs` partners, spread evenly over a fixed circle of the
    cases, so a cohort of hundreds costs no N² losses. Returns its case id and a table (case_id,
    mean_loss).
    """
    shapes = [matcher.shape(basis) for basis in bases]
    count = len(shapes)
    offsets = np.unique(
        np.linspace(1, count // 2, min(matcher.settings.template_pairs // 2 + 1, count // 2))
        .round()
        .astype(int)
    )
    losses: list[list[float]] = [[] for _ in shapes]
    pairs = {tuple(sorted((i, (i + o) % count))) for i in range(count) for o in offsets}
    for x, y in sorted(pairs):
        loss, _, _ = pair_loss(shapes[x], shapes[y], matcher.networks, 1, matcher.settings)
        losses[x].append(float(loss))
        losses[y].append(float(loss))
    means = [float(np.mean(row)) for row in losses]
    table = pd.DataFrame({"case_id": [basis.case_id for basis in bases], "mean_loss": means})
    return bases[int(np.argmin(means))].case_id, table

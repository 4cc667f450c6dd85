"""The choice of the template."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch

from ssm_pipeline.matching.map_health import map_extent
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.partners import partner_pairs


@torch.no_grad()
def choose_template(matcher: Matcher, bases: Sequence[SpectralBasis]) -> tuple[str, pd.DataFrame]:
    """The training shape whose mean loss to the others is smallest.

    Each candidate is tried on `template_pairs` partners (`partner_pairs`).

    Returns:
        Its case id and a table (case_id, mean_loss, map_extent): the last, the extent of the soft
        maps between the case and its partners over the target's own, is near 0 where the matcher
        has collapsed.
    """
    shapes = [matcher.shape(basis) for basis in bases]
    losses: list[list[float]] = [[] for _ in shapes]
    extents: list[list[float]] = [[] for _ in shapes]
    for x, y in partner_pairs(len(shapes), matcher.settings.template_pairs):
        loss, _, pair = pair_loss(shapes[x], shapes[y], matcher.networks, 1, matcher.settings)
        for case in (x, y):
            losses[case].append(float(loss))
            extents[case].append(map_extent(pair))
    means = [float(np.mean(row)) for row in losses]
    table = pd.DataFrame(
        {
            "case_id": [basis.case_id for basis in bases],
            "mean_loss": means,
            "map_extent": [float(np.mean(row)) for row in extents],
        }
    )
    return bases[int(np.argmin(means))].case_id, table

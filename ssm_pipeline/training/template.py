"""The choice of the template."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch

from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.partners import partner_pairs


@torch.no_grad()
def choose_template(matcher: Matcher, bases: Sequence[SpectralBasis]) -> tuple[str, pd.DataFrame]:
    """The training shape whose mean loss to the others is smallest.

    Each candidate is tried on `template_pairs` partners (`partner_pairs`). Returns its case id and
    a table (case_id, mean_loss).
    """
    shapes = [matcher.shape(basis) for basis in bases]
    losses: list[list[float]] = [[] for _ in shapes]
    for x, y in partner_pairs(len(shapes), matcher.settings.template_pairs):
        loss, _, _ = pair_loss(shapes[x], shapes[y], matcher.networks, 1, matcher.settings)
        losses[x].append(float(loss))
        losses[y].append(float(loss))
    means = [float(np.mean(row)) for row in losses]
    table = pd.DataFrame({"case_id": [basis.case_id for basis in bases], "mean_loss": means})
    return bases[int(np.argmin(means))].case_id, table

"""Recorded inputs: what the networks read from a small known shape.

The settings name the inputs, but the code computes them. A saved matcher therefore keeps the
inputs of one fixed shape. If another version of the code computes other inputs from it, the weights
would give other features without any message, so such a matcher is refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import network_inputs
from ssm_pipeline.records import StudyError

VERTICES, EIGENPAIRS = 8, 12
TOLERANCE = 1e-3  # the inputs are of order 1; processors differ by about 1e-12


def probe_inputs(settings: MatchingSettings) -> torch.Tensor:
    """The network inputs of the fixed shape.

    Args:
        settings: Which inputs, and how many descriptors.

    Returns:
        `(8, D)` float32.
    """
    generator = np.random.default_rng(0)
    eigenvalues = 10.0 * np.arange(EIGENPAIRS)
    vertices = 0.2 * generator.standard_normal((VERTICES, 3))
    eigenvectors = generator.standard_normal((VERTICES, EIGENPAIRS))
    inputs = network_inputs(vertices, eigenvalues, eigenvectors, settings)
    return torch.as_tensor(inputs, dtype=torch.float32)


def refuse_other_inputs(path: Path, recorded: torch.Tensor, settings: MatchingSettings) -> None:
    """Compare the inputs that a matcher was trained on with those that this version computes.

    Args:
        path: The matcher's file, for the message.
        recorded: `(8, D)`, the inputs of the fixed shape that the file holds.
        settings: The settings that the file holds.

    Raises:
        StudyError: Where the inputs differ.
    """
    computed = probe_inputs(settings)
    if recorded.shape == computed.shape:
        difference = float((recorded - computed).abs().max())
        if difference <= TOLERANCE:
            return
        found = f"they differ by up to {difference:.2g}"
    else:
        found = f"it read {recorded.shape[1]} inputs per vertex, not {computed.shape[1]}"
    raise StudyError(
        f"{path} was trained on other network inputs than this version computes: {found}. Its "
        "features would be wrong. Use the version it was trained with, or train again."
    )

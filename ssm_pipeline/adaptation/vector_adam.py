"""VectorAdam, the paper's solver: kept as the reference that the fast one is tested against."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.adaptation.objective import AdaptationObjective


def vector_adam(
    objective: AdaptationObjective,
    steps: int = 1000,
    learning_rate: float = 1e-3,
    betas: tuple[float, float] = (0.9, 0.999),
) -> tuple[np.ndarray, list[float]]:
    """Minimise from Δ = 0.

    Adam whose second moment is the squared length of each vertex's gradient, so that the steps turn
    with the shape.

    Returns:
        The last offsets (V, 3) and the objective at every 50th step.

    Source: Ling et al. 2022, "VectorAdam for rotation equivariant geometry optimization".
    """
    offsets = np.zeros_like(objective.vertices)
    first, second = np.zeros_like(offsets), np.zeros((len(offsets), 1))
    values = []
    for step in range(1, steps + 1):
        gradient = objective.gradient(offsets)
        first = betas[0] * first + (1 - betas[0]) * gradient
        squared_length = (gradient**2).sum(axis=1, keepdims=True)
        second = betas[1] * second + (1 - betas[1]) * squared_length
        direction = first / (1 - betas[0] ** step)
        size = np.sqrt(second / (1 - betas[1] ** step)) + 1e-12
        offsets -= learning_rate * direction / size
        if step % 50 == 0 or step == steps:
            values.append(objective.value(offsets))
    return offsets, values

"""Weights in eight bits each, for a file that ships."""

from __future__ import annotations

from typing import Any

import torch

_LARGEST = 127


def pack(state: dict[str, torch.Tensor]) -> dict[str, Any]:
    """Matrices as int8 with a scale per row, off by at most 1/254 of the row's largest; the rest,
    and the scales, in half precision."""
    return {
        name: _packed(value) if value.ndim > 1 else value.half() for name, value in state.items()
    }


def unpack(state: dict[str, Any]) -> dict[str, torch.Tensor]:
    """What `pack` packed, and what was never packed, as tensors."""
    return {
        name: value["steps"] * value["scale"].float() if isinstance(value, dict) else value
        for name, value in state.items()
    }


def _packed(weights: torch.Tensor) -> dict[str, torch.Tensor]:
    largest = weights.abs().amax(dim=tuple(range(1, weights.ndim)), keepdim=True)
    scale = (largest / _LARGEST).half()
    steps = (weights / scale.float().clamp(min=1e-30)).round().clamp(-_LARGEST, _LARGEST)
    return {"steps": steps.to(torch.int8), "scale": scale}

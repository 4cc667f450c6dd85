"""The soft point-to-point maps of a pair, both directions, never kept whole.

Π_xy = softmax over rows of F̂_X F̂_Yᵀ / τ, F̂ the features scaled to length 1. The maps are applied
block of rows by block of rows, and each block is computed again in the backward pass: memory is
block × n, not n × n. One exponential serves both directions, since the similarities lie in
[−1/τ, 1/τ] and need no running maximum.
"""

from __future__ import annotations

from typing import Any

import torch


def soft_maps(
    features_x: torch.Tensor,
    features_y: torch.Tensor,
    values_x: torch.Tensor,
    values_y: torch.Tensor,
    temperature: float,
    block_rows: int = 1024,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Carry values both ways: Π_xy values_y (n_x, c_y) and Π_yx values_x (n_y, c_x).

    features (n, channels) of any length; values (n, c). Differentiable in all four.
    """
    F_x = torch.nn.functional.normalize(features_x, dim=1)
    F_y = torch.nn.functional.normalize(features_y, dim=1)
    result: tuple[torch.Tensor, torch.Tensor] = _SoftMaps.apply(  # type: ignore[no-untyped-call]
        F_x, F_y, values_x, values_y, temperature, block_rows
    )
    return result


class _SoftMaps(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        F_x: torch.Tensor,
        F_y: torch.Tensor,
        values_x: torch.Tensor,
        values_y: torch.Tensor,
        temperature: float,
        block_rows: int,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        out_x = values_y.new_empty(len(F_x), values_y.shape[1])
        out_y = values_x.new_zeros(len(F_y), values_x.shape[1])
        row_sum = F_x.new_empty(len(F_x))
        column_sum = F_x.new_zeros(len(F_y))
        for start in range(0, len(F_x), block_rows):
            block = slice(start, start + block_rows)
            E = _exponentials(F_x[block], F_y, temperature)
            row_sum[block] = E.sum(dim=1)
            column_sum += E.sum(dim=0)
            torch.mm(E, values_y, out=out_x[block])
            out_y.addmm_(E.T, values_x[block])
        out_x /= row_sum[:, None]
        out_y /= column_sum[:, None]
        ctx.save_for_backward(F_x, F_y, values_x, values_y, out_x, out_y, row_sum, column_sum)
        ctx.temperature, ctx.block_rows = temperature, block_rows
        return out_x, out_y

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        F_x, F_y, values_x, values_y, out_x, out_y, row_sum, column_sum = ctx.saved_tensors
        grad_x = gradients[0] / row_sum[:, None]
        grad_y = gradients[1] / column_sum[:, None]
        # By the similarity: E ∘ (g_x values_yᵀ − ⟨g_x, out_x⟩ + values_x g_yᵀ − ⟨g_y, out_y⟩ᵀ), the
        # four terms as one matrix product.
        left = torch.cat(
            [grad_x, -(grad_x * out_x).sum(1, True), values_x, values_x.new_ones(len(F_x), 1)], 1
        )
        right = torch.cat(
            [values_y, values_y.new_ones(len(F_y), 1), grad_y, -(grad_y * out_y).sum(1, True)], 1
        )
        needs_values_x, needs_values_y = ctx.needs_input_grad[2:4]
        grad_F_x, grad_F_y = torch.empty_like(F_x), torch.zeros_like(F_y)
        grad_values_x = torch.empty_like(values_x) if needs_values_x else None
        grad_values_y = torch.zeros_like(values_y) if needs_values_y else None
        for start in range(0, len(F_x), ctx.block_rows):
            block = slice(start, start + ctx.block_rows)
            E = _exponentials(F_x[block], F_y, ctx.temperature)
            if grad_values_x is not None:
                torch.mm(E, grad_y, out=grad_values_x[block])
            if grad_values_y is not None:
                grad_values_y.addmm_(E.T, grad_x[block])
            E.mul_(left[block] @ right.T)
            torch.mm(E, F_y, out=grad_F_x[block])
            grad_F_y.addmm_(E.T, F_x[block])
        grad_F_x /= ctx.temperature
        grad_F_y /= ctx.temperature
        return grad_F_x, grad_F_y, grad_values_x, grad_values_y, None, None


def _exponentials(F_block: torch.Tensor, F_y: torch.Tensor, temperature: float) -> torch.Tensor:
    """exp((cosine − 1) / τ): at most 1."""
    return torch.mm(F_block, F_y.T).sub_(1).div_(temperature).exp_()

"""Sparse matrix times dense, differentiable in the dense factor."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch


class SparseMatrix:
    """A constant sparse matrix with its transpose kept beside it, for the backward pass.

    torch's own backward pass through a CSR product transposes the matrix at every call.
    """

    def __init__(self, matrix: sp.spmatrix, device: torch.device, dtype: torch.dtype) -> None:
        self.forward_csr = _to_torch(matrix.tocsr(), device, dtype)
        self.transpose_csr = _to_torch(matrix.T.tocsr(), device, dtype)

    def __matmul__(self, dense: torch.Tensor) -> torch.Tensor:
        """(R, V) @ (V, C) → (R, C)."""
        result: torch.Tensor = _Product.apply(dense, self)  # type: ignore[no-untyped-call]
        return result


def _to_torch(matrix: sp.csr_matrix, device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    with warnings.catch_warnings():  # torch calls CSR "beta" once a process
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support")
        warnings.filterwarnings("ignore", message="Sparse invariant checks are implicitly")  # 2.11
        return torch.sparse_csr_tensor(
            torch.from_numpy(matrix.indptr.astype(np.int64)),
            torch.from_numpy(matrix.indices.astype(np.int64)),
            torch.from_numpy(matrix.data),
            size=matrix.shape,
            dtype=dtype,
            device=device,
            check_invariants=False,
        )


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, dense: torch.Tensor, matrix: SparseMatrix) -> torch.Tensor:
        ctx.matrix = matrix
        return matrix.forward_csr @ dense

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return ctx.matrix.transpose_csr @ gradients[0].contiguous(), None

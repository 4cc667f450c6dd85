from typing import Any

import torch

from ssm_pipeline.matching.soft_map import soft_maps


def dense(F_x: Any, F_y: Any, v_x: Any, v_y: Any, tau: float = 0.07) -> Any:
    F_x, F_y = (torch.nn.functional.normalize(F, dim=1) for F in (F_x, F_y))
    S = F_x @ F_y.T / tau
    return S.softmax(1) @ v_y, S.T.softmax(1) @ v_x


def inputs(n_x: Any = 37, n_y: Any = 29, channels: Any = 8) -> Any:
    generator = torch.Generator().manual_seed(1)
    shapes = [(n_x, channels), (n_y, channels), (n_x, 4), (n_y, 5)]
    return [
        torch.randn(s, generator=generator, dtype=torch.float64, requires_grad=True) for s in shapes
    ]


def test_blocks_equal_the_dense_map_and_its_gradient() -> None:
    for block in (8, 10, 100):
        fast, plain = inputs(), inputs()
        F_x, F_y, v_x, v_y = fast
        out = soft_maps(F_x, F_y, v_x, v_y, temperature=0.07, block_rows=block)
        ref = dense(*plain)
        for a, b in zip(out, ref, strict=True):
            torch.testing.assert_close(a, b, rtol=1e-10, atol=1e-12)
        (out[0].sin().sum() + out[1].square().sum()).backward()
        (ref[0].sin().sum() + ref[1].square().sum()).backward()
        for a, b in zip(fast, plain, strict=True):
            torch.testing.assert_close(a.grad, b.grad, rtol=1e-8, atol=1e-10)


def test_gradient_against_finite_differences() -> None:
    arguments = inputs(7, 6, 3)
    assert torch.autograd.gradcheck(
        lambda F_x, F_y, v_x, v_y: soft_maps(F_x, F_y, v_x, v_y, 0.5, 3), arguments
    )


def test_rows_sum_to_one_and_own_features_find_themselves() -> None:
    F = torch.eye(20, dtype=torch.float64)
    values = torch.arange(20.0, dtype=torch.float64)[:, None]
    ones = torch.ones(20, 1, dtype=torch.float64)
    both = torch.cat([values, ones], 1)
    carried, back = soft_maps(F, F, both, both, 0.01)
    torch.testing.assert_close(carried[:, 1:], ones)
    torch.testing.assert_close(carried[:, :1], values)
    torch.testing.assert_close(back[:, :1], values)


def test_single_precision_stays_close() -> None:
    wide = inputs()
    narrow = [w.detach().float() for w in wide]

    def maps(F_x: Any, F_y: Any, v_x: Any, v_y: Any) -> Any:
        return soft_maps(F_x, F_y, v_x, v_y, 0.07, 16)

    for a, b in zip(maps(*narrow), maps(*wide), strict=True):
        torch.testing.assert_close(a.double(), b, rtol=1e-4, atol=1e-4)

import pytest
import torch

from ssm_pipeline.training.packed_weights import pack, unpack


def test_a_weight_is_off_by_a_254th_of_its_rows_largest_at_most() -> None:
    weights = torch.randn(40, 30, generator=torch.Generator().manual_seed(0))
    weights[3] *= 1e-4
    found = unpack(pack({"weight": weights}))["weight"]
    largest = weights.abs().amax(dim=1, keepdim=True)
    # The scale itself is rounded to half precision: 2⁻¹¹ of itself, more where it is subnormal.
    assert ((found - weights).abs() <= largest * (1 / 254 + 2**-10)).all()


def test_rows_of_nothing_stay_nothing() -> None:
    weights = torch.zeros(2, 3)
    weights[1] = 1.0
    assert unpack(pack({"weight": weights}))["weight"] == pytest.approx(weights, rel=1e-3)


def test_vectors_are_halved_and_what_was_never_packed_passes() -> None:
    bias = torch.tensor([1.0, -2.5])
    packed = pack({"bias": bias})
    assert packed["bias"].dtype == torch.float16
    assert torch.equal(unpack(packed)["bias"].float(), bias)
    assert unpack({"weight": bias})["weight"] is bias

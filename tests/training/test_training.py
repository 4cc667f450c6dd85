from pathlib import Path
from typing import Any

import pytest
import torch
from shapes import basis_of, blob

from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.path import shape_path
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.interpolation.settings import InterpolationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape
from ssm_pipeline.records import StudyError
from ssm_pipeline.spectral.wave_kernel import wave_kernel_signature
from ssm_pipeline.training.checkpoint import TrainingCheckpoint, load_checkpoint, save_checkpoint
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import load_matcher
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.pairs import Pairs
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.template_choice import choose_template
from ssm_pipeline.training.train import (
    clip_gradients,
    learning_rate_at,
    next_place,
    train_networks,
    turned_inputs,
)

SETTINGS = TrainingSettings(
    steps=8,
    time_steps=(1, 2),
    time_step_shares=(0.5, 0.5),
    checkpoint_every=3,
    matching=MatchingSettings(features="wks", descriptors=16, channels=16, width=16, blocks=1),
    interpolation=InterpolationSettings(width=16, blocks=1),
)


def gradients(network: torch.nn.Module) -> list[torch.Tensor]:
    """Those of all parameters; each must have one."""
    found = [parameter.grad for parameter in network.parameters()]
    given = [gradient for gradient in found if gradient is not None]
    assert len(given) == len(found)
    return given


@pytest.fixture(scope="module")
def bases() -> Any:
    return [basis_of(blob(seed, faces=300)) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def matcher(bases: Any) -> Any:
    return train_networks(bases, SETTINGS, seed=5)


def weights_of(matcher: Any) -> Any:
    return torch.cat([p.flatten() for p in matcher.networks.features.parameters()])


def test_the_loss_goes_down(bases: Any) -> None:
    losses = []
    longer = SETTINGS.model_copy(
        update={"steps": 60, "time_steps": (1,), "time_step_shares": (1.0,)}
    )
    train_networks(bases, longer, seed=0, on_step=lambda step, terms: losses.append(terms["total"]))
    assert sum(losses[-6:]) < 0.7 * sum(losses[:6])


def test_same_seed_same_bits_and_other_seed_others(bases: Any, matcher: Any) -> None:
    assert torch.equal(weights_of(matcher), weights_of(train_networks(bases, SETTINGS, seed=5)))
    assert not torch.equal(weights_of(matcher), weights_of(train_networks(bases, SETTINGS, seed=6)))


def test_a_stopped_run_goes_on_to_the_same_bits(bases: Any, matcher: Any, tmp_path: Path) -> None:
    checkpoints = []

    def keep(checkpoint: TrainingCheckpoint) -> None:
        checkpoints.append(checkpoint.step)
        save_checkpoint(checkpoint, tmp_path / f"{checkpoint.step}.pt")

    train_networks(bases, SETTINGS, seed=5, on_checkpoint=keep)
    assert checkpoints == [3, 6]
    resumed = train_networks(bases, SETTINGS, seed=5, start=load_checkpoint(tmp_path / "3.pt"))
    assert torch.equal(weights_of(matcher), weights_of(resumed))


def test_a_stored_matcher_is_the_same(bases: Any, matcher: Any, tmp_path: Path) -> None:
    matcher.save(tmp_path / "matcher.pt")
    loaded = load_matcher(tmp_path / "matcher.pt")
    assert loaded.settings == SETTINGS
    assert loaded.trained_on == ("blob1", "blob2", "blob3")
    shape = matcher.shape(bases[0])
    assert torch.equal(matcher.features(shape), loaded.features(shape))


def test_a_matcher_trained_on_other_inputs_is_refused(
    bases: Any, matcher: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ssm_pipeline.matching import shape

    def plain(*arguments: Any) -> Any:
        return wave_kernel_signature(*arguments)

    path = tmp_path / "matcher.pt"
    matcher.save(path)
    load_matcher(path)
    monkeypatch.setattr(shape, "wave_kernel_signature", lambda *a: 2 * plain(*a))
    with pytest.raises(StudyError, match=r"matcher.pt was trained on other network inputs.*up to"):
        load_matcher(path)
    monkeypatch.setattr(shape, "wave_kernel_signature", lambda *a: plain(*a)[:, :-1])
    with pytest.raises(StudyError, match="it read 16 inputs per vertex, not 15"):
        load_matcher(path)


def test_shapes_with_other_eigenpairs_are_refused_before_training(bases: Any) -> None:
    mixed = [*bases, basis_of(blob(4, faces=300), eigenpairs=30)]
    with pytest.raises(StudyError, match="blob1 has 20 eigenpairs and blob4 has 30"):
        train_networks(mixed, SETTINGS, seed=0, on_step=lambda step, terms: pytest.fail("trained"))


def test_the_seed_decides_the_order_of_the_pairs() -> None:
    orders = [[Pairs(5 * ["organ"], seed).at(step) for step in range(10)] for seed in (0, 0, 1)]
    assert orders[0] == orders[1]
    assert orders[0] != orders[2]
    drawn = [[Pairs(5 * ["o"], seed, most_listed=3).at(i) for i in range(10)] for seed in (0, 1)]
    assert drawn[0] != drawn[1]


def test_training_takes_its_seeds_order_of_pairs(
    bases: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, seen = Pairs.at, []

    def at(self: Pairs, index: int) -> tuple[int, int]:
        seen.append(real(self, index))
        return seen[-1]

    monkeypatch.setattr(Pairs, "at", at)
    orders = [[real(Pairs(3 * [""], seed), step) for step in range(3)] for seed in range(9)]
    seed = next(seed for seed in range(9) if orders[seed] != orders[0])
    train_networks(bases, SETTINGS.model_copy(update={"steps": 3, "pairs_per_step": 1}), seed)
    assert seen == orders[seed]


def test_an_epoch_shows_every_pair_once() -> None:
    pairs = Pairs(5 * ["organ"], seed=1)
    seen = {pairs.at(step) for step in range(10)}
    assert len(seen) == len(pairs) == 10
    first, second = ([pairs.at(s) for s in steps] for steps in (range(10), range(10, 20)))
    assert first != second


def test_pairs_are_of_one_family(bases: Any) -> None:
    pairs = Pairs(["a", "b", "a", "b"], seed=0)
    assert sorted(pairs.at(index) for index in range(2)) == [(0, 2), (1, 3)]
    with pytest.raises(StudyError, match="at least 2 shapes"):
        train_networks(bases, SETTINGS, seed=0, families=["a", "b", "c"])


def test_of_very_many_pairs_each_is_drawn_evenly_by_its_place() -> None:
    families = ["a"] * 4 + ["b"] * 3
    pairs = Pairs(families, seed=2, most_listed=8)
    drawn = [pairs.at(index) for index in range(900)]
    assert drawn[7] == Pairs(families, seed=2, most_listed=8).at(7)
    counts = {pair: drawn.count(pair) for pair in Pairs(families, seed=0)._all()}
    assert sum(counts.values()) == 900
    assert min(counts.values()) > 60  # of 100 ± 9.5 a pair
    assert max(counts.values()) < 140
    many = Pairs(["organ"] * 100_000, seed=0)  # listed, these would be 4 GB
    assert many.listed is None
    assert len({many.at(index) for index in range(100)}) == 100


def test_schedules() -> None:
    assert [SETTINGS.intervals_at(s) for s in (0, 3, 4, 7)] == [1, 1, 2, 2]
    assert learning_rate_at(0, SETTINGS) == pytest.approx(1e-3)
    assert learning_rate_at(8, SETTINGS) == pytest.approx(1e-4)
    with pytest.raises(ValueError, match=r"add up to 0\.5"):
        TrainingSettings(time_steps=(1,), time_step_shares=(0.5,))


def test_the_loss_of_a_pair_is_symmetric(bases: Any, matcher: Any) -> None:
    networks = Networks.new(SETTINGS, 0)
    x, y = matcher.shape(bases[0]), matcher.shape(bases[1])
    forward, _, _ = pair_loss(x, y, networks, 2, SETTINGS)
    backward, _, _ = pair_loss(y, x, networks, 2, SETTINGS)
    torch.testing.assert_close(forward, backward, rtol=1e-3, atol=1e-3)


def test_without_the_spatial_loss_only_the_features_learn(bases: Any) -> None:
    settings = SETTINGS.spectral_only()
    rows: list[dict[str, float]] = []
    trained = train_networks(
        bases, settings, seed=5, on_step=lambda step, losses: rows.append(losses)
    )
    fresh = Networks.new(settings, 5)
    assert set(rows[-2]) == {"schedule", "total", "bijectivity", "orthogonality", "coupling"}
    pairs = zip(fresh.both(), trained.networks.both(), strict=True)
    features, interpolator = (
        list(zip(before.parameters(), after.parameters(), strict=True)) for before, after in pairs
    )
    assert all(torch.equal(before, after) for before, after in interpolator)
    assert not any(torch.equal(before, after) for before, after in features[:-1])  # not the bias


def test_one_shape_is_too_few(bases: Any) -> None:
    with pytest.raises(StudyError, match="at least 2 shapes; 1 found"):
        train_networks(bases[:1], SETTINGS, seed=0)


def test_template_has_the_smallest_mean_loss(bases: Any, matcher: Any) -> None:
    name, table = choose_template(matcher, bases)
    shapes = [matcher.shape(basis) for basis in bases]

    def loss(x: Any, y: Any) -> Any:
        return float(pair_loss(shapes[x], shapes[y], matcher.networks, 1, matcher.settings)[0])

    with torch.no_grad():
        between = {(x, y): loss(x, y) for x, y in ((0, 1), (0, 2), (1, 2))}
    expected = [(between[0, 1] + between[0, 2]) / 2, (between[0, 1] + between[1, 2]) / 2]
    expected.append((between[0, 2] + between[1, 2]) / 2)
    assert table["mean_loss"].tolist() == pytest.approx(expected, rel=1e-5)
    assert name == bases[expected.index(min(expected))].case_id


def test_path_runs_from_template_to_case_in_millimetres(bases: Any, matcher: Any) -> None:
    template, case = bases[:2]
    settings = AdaptationSettings(samples=2000, path_times=3)
    path = shape_path(template, case, matcher, settings)
    start = template.frame.apply(template.vertices)
    assert abs(path.at(0, 0) - start).max() < 1e-4
    match = correspond_bases(template, case, matcher, settings, "network start")
    # X(1, 1) of the path is the surface that this start carries onto the case.
    assert abs(path.at(1, 1) - match.fitted).max() < 1e-3
    halfway = path.at(0.25, 0.5)
    assert abs(halfway - 0.5 * (path.at(0.25, 0) + path.at(0.25, 1))).max() < 1e-9
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\]"):
        path.at(1.2)


def test_dropout_and_turns_are_drawn_by_seed_and_step(bases: Any, tmp_path: Path) -> None:
    settings = SETTINGS.model_copy(
        update={
            "turn_deg": 30.0,
            "jitter": 0.05,
            "matching": SETTINGS.matching.model_copy(
                update={"dropout": 0.5, "features": "xyz+wks"}
            ),
        }
    )
    whole = train_networks(
        bases,
        settings,
        seed=5,
        on_checkpoint=lambda c: save_checkpoint(c, tmp_path / f"{c.step}.pt"),
    )
    torch.manual_seed(99)  # what lies in torch's own generator does not matter
    resumed = train_networks(bases, settings, seed=5, start=load_checkpoint(tmp_path / "3.pt"))
    assert torch.equal(weights_of(whole), weights_of(resumed))
    assert not torch.equal(weights_of(whole), weights_of(train_networks(bases, settings, seed=6)))


def test_turned_coordinates_are_a_rotation_and_leave_the_rest() -> None:
    settings = SETTINGS.model_copy(
        update={
            "turn_deg": 40.0,
            "matching": SETTINGS.matching.model_copy(update={"features": "xyz+wks"}),
        }
    )
    shape = to_shape(basis_of(blob(1)), settings.matching)
    turned, _ = turned_inputs(shape, shape, settings)
    assert torch.equal(shape.inputs[:, 3:], turned.inputs[:, 3:])
    assert torch.equal(shape.vertices, turned.vertices)
    before, after = shape.inputs[:, :3], turned.inputs[:, :3]
    torch.testing.assert_close(before @ before.T, after @ after.T, rtol=1e-4, atol=1e-5)
    assert (before - after).abs().max() > 1e-3


def test_both_shapes_can_be_turned_together() -> None:
    matching = SETTINGS.matching.model_copy(update={"features": "xyz+wks"})
    settings = SETTINGS.model_copy(update={"turn_together": True, "matching": matching})
    x = to_shape(basis_of(blob(1)), matching)
    one, other = turned_inputs(x, x, settings)
    assert torch.equal(one.inputs, other.inputs)
    assert (one.inputs - x.inputs).abs().max() > 1e-3


def test_the_map_is_watched_now_and_then(bases: Any) -> None:
    rows: list[dict[str, float]] = []
    settings = SETTINGS.model_copy(update={"watch_every": 4})
    train_networks(bases, settings, seed=5, on_step=lambda step, losses: rows.append(losses))
    watched = [step for step, row in enumerate(rows) if "map_extent" in row]
    assert watched == [0, 4, 7]
    assert 0 < rows[0]["share_hit"] <= 1


@pytest.mark.parametrize("alone", [True, False])
def test_gradients_are_clipped_network_by_network_or_together(alone: bool) -> None:
    networks = Networks.new(SETTINGS, 0)
    for factor, network in zip((10.0, 0.001), networks.both(), strict=True):
        for parameter in network.parameters():
            parameter.grad = torch.full_like(parameter, factor)
    settings = SETTINGS.model_copy(update={"clip_each_network": alone, "gradient_clip": 1.0})
    small = [gradient.clone() for gradient in gradients(networks.interpolator)]
    assert clip_gradients(networks, settings)
    norms = [
        torch.cat([gradient.flatten() for gradient in gradients(network)]).norm()
        for network in networks.both()
    ]
    if alone:
        assert norms[0] == pytest.approx(1.0, rel=1e-4)
        kept = zip(small, gradients(networks.interpolator), strict=True)
        assert all(torch.equal(before, after) for before, after in kept)
    else:
        assert float(norms[0] ** 2 + norms[1] ** 2) == pytest.approx(1.0, rel=1e-4)
        assert norms[1] < 1e-3


def test_on_a_plateau_training_goes_on_at_the_next_t_and_ends_after_the_last() -> None:
    settings = SETTINGS.model_copy(
        update={
            "steps": 100,
            "time_steps": (1, 3),
            "time_step_shares": (0.7, 0.3),
            "patience": 5,
        }
    )
    falling = [{"schedule": float(step), "total": 100.0 * 0.9**step} for step in range(20)]
    assert next_place(falling, settings) == 20
    flat = [{"schedule": float(step), "total": 100.0} for step in range(20)]
    assert next_place(flat[:9], settings) == 9
    assert next_place(flat, settings) == 70
    just_moved = [*flat, {"schedule": 70.0, "total": 100.0}]
    assert next_place(just_moved, settings) == 71  # the steps before were of another T
    flat_again = flat + [{"schedule": 70.0 + step, "total": 100.0} for step in range(10)]
    assert next_place(flat_again, settings) == 100
    assert next_place(flat, settings.model_copy(update={"patience": 0})) == 20


def test_a_training_that_ended_on_a_plateau_resumes_to_the_same_bits(
    bases: Any, tmp_path: Path
) -> None:
    settings = SETTINGS.model_copy(update={"steps": 60, "patience": 2, "checkpoint_every": 3})
    rows: list[dict[str, float]] = []
    whole = train_networks(
        bases,
        settings,
        seed=5,
        on_checkpoint=lambda c: save_checkpoint(c, tmp_path / f"{c.step}.pt"),
        on_step=lambda step, losses: rows.append(losses),
    )
    assert len(rows) < 60
    resumed = train_networks(bases, settings, seed=5, start=load_checkpoint(tmp_path / "3.pt"))
    assert torch.equal(weights_of(whole), weights_of(resumed))

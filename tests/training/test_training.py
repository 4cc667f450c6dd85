import pytest
import torch
from shapes import basis_of, blob

from ssm_pipeline.adaptation.correspond import correspond
from ssm_pipeline.adaptation.path import shape_path
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.interpolation.settings import InterpolationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.records import StudyError
from ssm_pipeline.training.checkpoint import load_checkpoint, save_checkpoint
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import load_matcher, new_networks, save_matcher
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.template import choose_template
from ssm_pipeline.training.train import learning_rate_at, pair_at, train

SETTINGS = TrainingSettings(
    steps=8,
    time_steps=(0, 2),
    time_step_shares=(0.5, 0.5),
    checkpoint_every=3,
    matching=MatchingSettings(descriptors=16, channels=16, width=16, blocks=1),
    interpolation=InterpolationSettings(width=16, blocks=1),
)


@pytest.fixture(scope="module")
def bases():
    return [basis_of(blob(seed, faces=300)) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def matcher(bases):
    return train(bases, SETTINGS, seed=5)


def weights_of(matcher):
    return torch.cat([p.flatten() for p in matcher.feature_network.parameters()])


def test_the_loss_goes_down(bases):
    losses = []
    longer = SETTINGS.model_copy(
        update={"steps": 60, "time_steps": (0,), "time_step_shares": (1.0,)}
    )
    train(bases, longer, seed=0, on_step=lambda step, terms: losses.append(terms["total"]))
    assert sum(losses[-6:]) < 0.7 * sum(losses[:6])


def test_same_seed_same_bits_and_other_seed_others(bases, matcher):
    assert torch.equal(weights_of(matcher), weights_of(train(bases, SETTINGS, seed=5)))
    assert not torch.equal(weights_of(matcher), weights_of(train(bases, SETTINGS, seed=6)))


def test_a_stopped_run_goes_on_to_the_same_bits(bases, matcher, tmp_path):
    checkpoints = []
    train(
        bases,
        SETTINGS,
        seed=5,
        on_checkpoint=lambda c: (
            checkpoints.append(c.step),
            save_checkpoint(c, tmp_path / f"{c.step}.pt"),
        ),
    )
    assert checkpoints == [3, 6]
    resumed = train(bases, SETTINGS, seed=5, start=load_checkpoint(tmp_path / "3.pt"))
    assert torch.equal(weights_of(matcher), weights_of(resumed))


def test_a_stored_matcher_is_the_same(bases, matcher, tmp_path):
    save_matcher(matcher, tmp_path / "matcher.pt")
    loaded = load_matcher(tmp_path / "matcher.pt")
    assert loaded.settings == SETTINGS
    assert loaded.trained_on == ("blob1", "blob2", "blob3")
    shape = matcher.shape(bases[0])
    assert torch.equal(matcher.features(shape), loaded.features(shape))


def test_an_epoch_shows_every_pair_once():
    seen = {pair_at(step, 5, seed=1) for step in range(10)}
    assert len(seen) == 10
    assert [pair_at(s, 5, 1) for s in range(10)] != [pair_at(s, 5, 1) for s in range(10, 20)]


def test_schedules():
    assert [SETTINGS.time_steps_at(s) for s in (0, 3, 4, 7)] == [0, 0, 2, 2]
    assert learning_rate_at(0, SETTINGS) == pytest.approx(1e-3)
    assert learning_rate_at(8, SETTINGS) == pytest.approx(1e-4)
    with pytest.raises(ValueError, match=r"add up to 0\.5"):
        TrainingSettings(time_steps=(0,), time_step_shares=(0.5,))


def test_the_loss_of_a_pair_is_symmetric(bases, matcher):
    networks = new_networks(SETTINGS, 0)
    x, y = matcher.shape(bases[0]), matcher.shape(bases[1])
    forward, _ = pair_loss(x, y, *networks, 2, SETTINGS)
    backward, _ = pair_loss(y, x, *networks, 2, SETTINGS)
    torch.testing.assert_close(forward, backward, rtol=1e-3, atol=1e-3)


def test_without_the_spatial_loss_only_the_features_learn(bases):
    settings = SETTINGS.spectral_only()
    rows: list[dict[str, float]] = []
    trained = train(bases, settings, seed=5, on_step=lambda step, losses: rows.append(losses))
    features, interpolator = new_networks(settings, 5)
    assert set(rows[-1]) == {"total", "bijectivity", "orthogonality", "coupling"}
    before, after = (list(net.parameters()) for net in (interpolator, trained.interpolator))
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    before, after = (list(net.parameters()) for net in (features, trained.feature_network))
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))


def test_one_shape_is_too_few(bases):
    with pytest.raises(StudyError, match="at least 2 shapes; 1 found"):
        train(bases[:1], SETTINGS, seed=0)


def test_template_has_the_smallest_mean_loss(bases, matcher):
    name, table = choose_template(matcher, bases)
    assert name == table.loc[table.mean_loss.idxmin(), "case_id"]
    assert len(table) == 3


def test_path_runs_from_template_to_case_in_millimetres(bases, matcher):
    template, case = bases[:2]
    settings = AdaptationSettings(samples=2000, path_times=3)
    path = shape_path(template, case, matcher, settings)
    start = template.frame.apply(template.vertices)
    assert abs(path.at(0, 0) - start).max() < 1e-4
    match = correspond(template, case, matcher, settings)
    # X(1, 1) of the path is the surface that the full method carries onto the case.
    assert abs(path.at(1, 1) - match.fitted).max() < 1e-3
    halfway = path.at(0.25, 0.5)
    assert abs(halfway - 0.5 * (path.at(0.25, 0) + path.at(0.25, 1))).max() < 1e-9
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\]"):
        path.at(1.2)

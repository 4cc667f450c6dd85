from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import f as central_f
from scipy.stats import f_oneway, kstest, ttest_ind
from statsmodels.multivariate.manova import MANOVA
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.multivariate import test_mvmean_2indep as two_sample_t2
from statsmodels.stats.power import TTestIndPower

from ssm_pipeline.records import CorrespondedShapes, StudyError
from ssm_pipeline.shape_model.pca import pca_model
from ssm_pipeline.statistics.compare import compare, modes_carried
from ssm_pipeline.statistics.covariates import design_of, matched_to_cases
from ssm_pipeline.statistics.effects import (
    bootstrap_coefficients,
    coefficients,
    explained_share,
)
from ssm_pipeline.statistics.permutation import (
    _split,
    mode_tests,
    multivariate_test,
    procrustes_test,
    vertex_test,
)
from ssm_pipeline.statistics.power import detectable_sd, power

GROUP = np.repeat([0.0, 1.0], 20)
DESIGN = np.column_stack([np.ones(40), GROUP])


def test_the_statistic_and_p_are_those_of_manova() -> None:
    generator = np.random.default_rng(0)
    age = generator.standard_normal(40) + GROUP
    scores = generator.standard_normal((40, 3)) + 0.6 * GROUP[:, None] + age[:, None]
    design = np.column_stack([DESIGN, age])
    test = multivariate_test(scores, design, [1], 1999, generator)
    frame = pd.DataFrame(scores, columns=["a", "b", "c"]).assign(g=GROUP, age=age)
    result = MANOVA.from_formula("a + b + c ~ g + age", frame).mv_test().results["g"]["stat"]
    trace = float(result.loc["Hotelling-Lawley trace", "Value"])
    assert test.statistic == pytest.approx(37 * trace)
    assert test.degrees == (1, 37)
    # Normal scores: the permutation p is the F test's, but for its own scatter √(p(1 − p)/1999).
    p = float(result.loc["Hotelling-Lawley trace", "Pr > F"])
    assert abs(test.p - p) < 4 * np.sqrt(p / 2000) + 0.005


def test_one_mode_is_the_t_test() -> None:
    scores = np.random.default_rng(2).standard_normal((40, 1)) + 0.5 * GROUP[:, None]
    p = ttest_ind(scores[:20, 0], scores[20:, 0]).pvalue
    found = mode_tests(scores, DESIGN, [1], 1999, np.random.default_rng(0))[0]
    assert abs(found - p) < 4 * np.sqrt(p * (1 - p) / 1999) + 1e-3


@pytest.mark.parametrize("confounded", [False, True])
def test_p_values_are_even_where_nothing_is(confounded: bool) -> None:
    generator = np.random.default_rng(5)
    values = []
    for _ in range(120):
        age = generator.standard_normal(40) + 2.0 * confounded * GROUP
        scores = generator.standard_normal((40, 2)) + age[:, None] * [1.0, -0.5]
        design = np.column_stack([DESIGN, age])
        values.append(multivariate_test(scores, design, [1], 99, generator).p)
    # Even but for steps of 1/100; the test's own level is 1 in 1000, and the seed is fixed.
    assert kstest(values, "uniform").pvalue > 1e-3
    # Without the covariate, what age does is taken for the group's.
    alone = multivariate_test(scores, DESIGN, [1], 99, generator).p
    assert alone <= 0.02 or not confounded


def test_procrustes_anova_does_not_care_how_the_axes_lie() -> None:
    generator = np.random.default_rng(8)
    scores = generator.standard_normal((40, 5)) * [9.0, 3.0, 1.0, 1.0, 1.0]
    scores[:, 0] += 9.0 * GROUP
    turned = scores @ np.linalg.qr(generator.standard_normal((5, 5)))[0]
    one, other = (
        procrustes_test(values, DESIGN, [1], 199, np.random.default_rng(1))
        for values in (scores, turned)
    )
    assert one.p == other.p <= 0.02
    assert one.statistic == pytest.approx(other.statistic)
    shares = explained_share(scores, DESIGN, [1])
    assert one.statistic == pytest.approx(38 * shares / (1 - shares))
    assert one.degrees == (1, 38)


def test_a_map_finds_the_vertices_that_move_and_no_others() -> None:
    generator = np.random.default_rng(3)
    vertices = generator.standard_normal((40, 30, 3))
    vertices[:, :10] += 5.0 * GROUP[:, None, None]
    p = vertex_test(vertices, DESIGN, [1], 199, generator)
    # No permutation of 199 reaches what was planted; the observed order itself counts as one.
    assert (p[:10] == 1 / 200).all()
    assert (p[10:] > 0.05).mean() > 0.75
    np.testing.assert_allclose(
        coefficients(vertices, DESIGN)[1], vertices[20:].mean(0) - vertices[:20].mean(0)
    )


def test_shares_and_intervals() -> None:
    generator = np.random.default_rng(4)
    noise = generator.standard_normal((40, 2))
    values = noise + GROUP[:, None] * [3.0, 0.0]
    low, high = bootstrap_coefficients(values, DESIGN, 1, 400, generator)
    assert low[0] > 1.5
    assert high[0] < 4.5
    assert low[1] < 0 < high[1]
    # A group 3 SD away adds 9/4 to a variance of 2: about a half is the group's.
    assert 0.35 < explained_share(values, DESIGN, [1]) < 0.7
    assert explained_share(noise, DESIGN, [1]) < 0.15


def test_power_is_that_of_the_t_test_for_one_mode() -> None:
    theirs = TTestIndPower().power(0.8, nobs1=20, alpha=0.05)
    assert power(0.8, DESIGN, 1, 1) == pytest.approx(theirs, abs=1e-6)
    stricter = TTestIndPower().power(1.0, nobs1=20, alpha=0.01)
    assert power(1.0, DESIGN, 1, 1, level=0.01) == pytest.approx(stricter, abs=1e-6)
    found = detectable_sd(DESIGN, 1, 1)
    assert power(found, DESIGN, 1, 1) == pytest.approx(0.8)
    assert detectable_sd(DESIGN, 1, 6) > found
    assert detectable_sd(DESIGN[:, :2], 1, 39) == np.inf
    assert power(0.0, DESIGN, 1, 2) == pytest.approx(
        central_f.sf(central_f.isf(0.05, 2, 37), 2, 37)
    )


def a_cohort() -> Any:
    generator = np.random.default_rng(6)
    modes = generator.standard_normal((4, 25, 3)) * np.array([4.0, 3.0, 2.0, 1.0])[:, None, None]
    scores = generator.standard_normal((40, 4))
    scores[:, 1] += 2.0 * GROUP
    points = 20 * generator.standard_normal((25, 3)) + np.einsum("nm,mvd->nvd", scores, modes)
    ids = tuple(f"p{index:02d}" for index in range(40))
    faces = np.array([[0, 1, 2]])
    return CorrespondedShapes(points, faces, ids, "p00")


def test_a_whole_comparison() -> None:
    shapes = a_cohort()
    model = pca_model(shapes)
    table = pd.DataFrame(
        {
            "case_id": shapes.case_ids,
            "group": np.where(GROUP == 1, "ill", "fit"),
            "age": np.random.default_rng(9).uniform(30, 60, 40),
        }
    )
    design = design_of("~ group + age", matched_to_cases(table, shapes.case_ids))
    result = compare(
        model,
        shapes.vertices,
        design,
        np.random.default_rng(0),
        permutations=199,
        vertex_permutations=99,
        draws=50,
    )
    assert list(result.tests["term"]) == ["group", "age"]
    assert result.tests["hotelling_p"][0] == 0.005
    assert result.tests["hotelling_p"][1] > 0.05
    assert result.tests["procrustes_p"][0] <= 0.01
    assert [one.name.partition(":")[0] for one in result.maps] == ["group", "age"]
    assert result.maps[0].displacement_mm.shape == (25, 3)
    assert (result.maps[0].q < 0.05).mean() > 0.8
    for _, rows in result.modes.groupby("effect"):
        np.testing.assert_allclose(rows["q"], multipletests(rows["p"], method="fdr_bh")[1])
    for each in result.maps:
        np.testing.assert_allclose(each.q, multipletests(each.p, method="fdr_bh")[1])
        assert (each.q > each.p).any()
    # The step of a covariate is 1 SD of it, for the change, for its interval and for the map.
    age = table["age"].to_numpy()
    slope = np.linalg.lstsq(design.matrix, model.scores[:, : result.mode_count], rcond=None)[0][2]
    of_age = result.modes[result.modes["effect"].str.startswith("age")]
    np.testing.assert_allclose(of_age["change_sd"], slope * age.std(ddof=1))
    per_year = np.linalg.lstsq(design.matrix, shapes.vertices.reshape(40, -1), rcond=None)[0][2]
    found = result.maps[1].displacement_mm.ravel()
    np.testing.assert_allclose(found, per_year * age.std(ddof=1), atol=1e-9)
    for row in result.modes.itertuples():
        assert row.change_low_sd < row.change_sd < row.change_high_sd
    assert result.power["effect"][0] == "group: ill against fit"
    # The same draws again, with ages in months: no number is of the unit.
    in_months = table.assign(age=12 * table["age"])
    again = compare(
        model,
        shapes.vertices,
        design_of("~ group + age", matched_to_cases(in_months, shapes.case_ids)),
        np.random.default_rng(0),
        permutations=199,
        vertex_permutations=99,
        draws=50,
    )
    numbers = result.modes.columns.drop("effect")
    np.testing.assert_allclose(result.modes[numbers], again.modes[numbers], atol=1e-9)


def test_more_modes_than_the_cases_carry_are_refused_with_the_number_they_do() -> None:
    model = pca_model(a_cohort())
    with pytest.raises(StudyError, match="1 to 4 modes"):
        modes_carried(model, DESIGN, 20)
    assert modes_carried(model, DESIGN, 3) == 3
    few = DESIGN[[0, 20, 1, 21]]
    with pytest.raises(StudyError, match="leave 2 degrees of freedom"):
        modes_carried(model, few)


def test_hotellings_t2_is_the_two_sample_statistic() -> None:
    generator = np.random.default_rng(11)
    scores = generator.standard_normal((40, 3)) + 0.4 * GROUP[:, None]
    found = multivariate_test(scores, DESIGN, [1], 9, generator).statistic
    assert found == pytest.approx(two_sample_t2(scores[:20], scores[20:]).t2)
    apart = scores[20:].mean(axis=0) - scores[:20].mean(axis=0)
    pooled = (np.cov(scores[:20].T) + np.cov(scores[20:].T)) / 2
    assert found == pytest.approx(10 * apart @ np.linalg.solve(pooled, apart))


def test_procrustes_f_is_that_of_anova_and_of_anderson() -> None:
    """One coordinate: one-way ANOVA. Several: Anderson's pseudo-F of squared distances."""
    generator = np.random.default_rng(12)
    groups = np.repeat([0, 1, 2], [10, 14, 16])
    design = np.column_stack([np.ones(40), groups == 1, groups == 2]).astype(float)
    values = generator.standard_normal((40, 3)) + groups[:, None] * [0.5, 0.0, 0.2]
    one = procrustes_test(values[:, :1], design, [1, 2], 9, generator)
    parts = [values[groups == group, 0] for group in range(3)]
    assert one.statistic == pytest.approx(f_oneway(*parts).statistic)
    assert one.degrees == (2, 37)
    squared = ((values[:, None] - values[None]) ** 2).sum(axis=2)
    total = squared[np.triu_indices(40)].sum() / 40
    within = sum(
        squared[np.ix_(rows, rows)][np.triu_indices(len(rows))].sum() / len(rows)
        for rows in (np.flatnonzero(groups == group) for group in range(3))
    )
    several = procrustes_test(values, design, [1, 2], 9, generator)
    assert several.statistic == pytest.approx((total - within) / 2 / (within / 37))


def test_permutations_are_freedman_and_lanes() -> None:
    """Residuals without the tested column, permuted, and fitted by both models again."""
    generator = np.random.default_rng(13)
    count, covariates = 24, 6
    nuisance = np.column_stack([np.ones(count), generator.standard_normal((count, covariates))])
    tested = generator.standard_normal(count) + nuisance[:, 1]
    matrix = np.column_stack([nuisance, tested])
    scores = generator.standard_normal((count, 2)) + nuisance[:, 1:3]

    def rest(values: np.ndarray, on: np.ndarray) -> np.ndarray:
        residuals: np.ndarray = values - on @ np.linalg.lstsq(on, values, rcond=None)[0]
        return residuals

    def trace(values: np.ndarray) -> float:
        small, large = (each.T @ each for each in (rest(values, matrix), rest(values, nuisance)))
        return float(np.trace(np.linalg.solve(small, large - small)))

    residuals = rest(scores, nuisance)
    fitted = scores - residuals
    orders = np.random.default_rng(1)
    drawn = [fitted + residuals[orders.permutation(count)] for _ in range(60)]
    found = multivariate_test(scores, matrix, [7], 60, np.random.default_rng(1))
    observed = trace(scores)
    assert found.statistic == pytest.approx((count - 8) * observed, rel=1e-10)
    assert found.p == (1 + sum(trace(values) >= observed for values in drawn)) / 61
    split = _split(scores, matrix, [7])
    permuted = list(split.permuted(60, np.random.default_rng(1)))[1:]
    for one, other in zip(permuted, drawn, strict=True):
        np.testing.assert_allclose(one, rest(other, nuisance), atol=1e-10)


def test_p_values_of_modes_count_the_observed_order() -> None:
    planted = 9.0 * GROUP[:, None] + np.random.default_rng(2).standard_normal((40, 2))
    assert mode_tests(planted, DESIGN, [1], 19, np.random.default_rng(0)).tolist() == [0.05] * 2


def test_another_seed_draws_other_permutations_and_intervals() -> None:
    scores = np.random.default_rng(2).standard_normal((40, 3)) + 0.3 * GROUP[:, None]
    one, other = (
        (
            multivariate_test(scores, DESIGN, [1], 199, np.random.default_rng(seed)).p,
            bootstrap_coefficients(scores, DESIGN, 1, 50, np.random.default_rng(seed))[0].tolist(),
        )
        for seed in (0, 1)
    )
    assert one[0] != other[0]
    assert one[1] != other[1]


def test_power_for_several_modes_is_how_often_an_effect_is_found() -> None:
    """By the exact F test of T² on normal scores, 400 cohorts: standard error 0.025."""
    generator = np.random.default_rng(3)
    found = []
    for _ in range(400):
        scores = generator.standard_normal((40, 3))
        scores[:, 0] += GROUP
        found.append(two_sample_t2(scores[:20], scores[20:]).pvalue < 0.05)
    assert np.mean(found) == pytest.approx(power(1.0, DESIGN, 1, 3), abs=0.08)

"""Does `compare` find an effect that is there, and how often one that is not?

    python benchmarks/compare_planted_effects.py [--cases 40] [--nulls 200] [--planted 200]

Lungs of known modes, drawn in correspondence, in two groups of equal size. Planted: the first mode
shifted by one standard deviation in one group. Null: no shift. Each with and without a confounder,
an age that goes with the group and moves the second mode. Prints how often p < 0.05 where nothing
is, with the interval that chance allows, and how often p < 0.01 where something is, beside two
bounds: what theory says of Hotelling's test with that many modes and normal scores, and a test of
the true scores of the shifted mode alone, which no test of shapes can know.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
from scipy.stats import binom

from ssm_pipeline.data_prep.synthetic.smooth_lung import mean_lung, mode_fields
from ssm_pipeline.records import CorrespondedShapes
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model
from ssm_pipeline.statistics.compare import modes_carried
from ssm_pipeline.statistics.covariates import design_of, matched_to_cases
from ssm_pipeline.statistics.permutation import mode_tests, multivariate_test, procrustes_test
from ssm_pipeline.statistics.power import power

SHIFTED, MOVED_BY_AGE = 0, 1  # modes
NOISE_MM = 0.3  # of every point, as matching leaves it


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--nulls", type=int, default=200)
    parser.add_argument("--planted", type=int, default=200)
    parser.add_argument("--permutations", type=int, default=999)
    parser.add_argument("--subdivisions", type=int, default=2, help="of the lung's surface")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    lungs = Lungs(arguments.subdivisions)
    rows = []
    for shift, count in ((0.0, arguments.nulls), (1.0, arguments.planted)):
        for confounded in (False, True):
            generator = np.random.default_rng(arguments.seed)
            cases, draws = arguments.cases, arguments.permutations
            found = [
                p_values(lungs, cases, shift, confounded, draws, generator) for _ in range(count)
            ]
            table = pd.DataFrame(found)
            theory = table[["hotelling_theory", "true_score_theory"]].mean()
            table = table.drop(columns=theory.index)
            row = {"shift_sd": shift, "confounder": confounded, "cohorts": count}
            for test in table.columns.drop("modes"):
                row[f"{test}_below_0.05"] = (table[test] < 0.05).mean()
                row[f"{test}_below_0.01"] = (table[test] < 0.01).mean()
            row |= {f"{name}_below_0.01": chance for name, chance in theory.items()}
            row["modes"] = table["modes"].mean()
            rows.append(row)
    low, high = 100 * np.array(binom.interval(0.95, arguments.nulls, 0.05)) / arguments.nulls
    print(pd.DataFrame(rows).round(4).T.to_string(header=False))
    print(f"where nothing is, chance allows {low / 100:.3f} to {high / 100:.3f} below 0.05")


class Lungs:
    """The phantom lung's mean and its modes at one standard deviation, on few vertices."""

    def __init__(self, subdivisions: int) -> None:
        self.mean, self.faces = mean_lung(subdivisions)
        self.modes = np.stack([field(self.mean) for field in mode_fields()])

    def cohort(self, scores: np.ndarray, generator: np.random.Generator) -> CorrespondedShapes:
        """Shapes of scores (N, M), each point off by noise of its own."""
        shapes = self.mean + np.einsum("nm,mvd->nvd", scores, self.modes)
        shapes = shapes + NOISE_MM * generator.standard_normal(shapes.shape)
        ids = tuple(f"case_{index:03d}" for index in range(len(scores)))
        return CorrespondedShapes(shapes, self.faces, ids, ids[0])


def p_values(
    lungs: Lungs,
    cases: int,
    shift: float,
    confounded: bool,
    permutations: int,
    generator: np.random.Generator,
) -> dict[str, float]:
    """Test → p of the group; modes: how many were tested; theory: the power at p < 0.01."""
    group = np.repeat([0.0, 1.0], [cases // 2, cases - cases // 2])
    scores = generator.standard_normal((cases, len(lungs.modes)))
    scores[:, SHIFTED] += shift * group
    table = pd.DataFrame({"case_id": [f"case_{i:03d}" for i in range(cases)], "group": group})
    formula = "~ group"
    if confounded:
        age = generator.standard_normal(cases) + group
        scores[:, MOVED_BY_AGE] += age
        table, formula = table.assign(age=age), "~ group + age"
    shapes = lungs.cohort(scores, generator)
    model = pca_model(align(shapes)[0])
    design = design_of(formula, matched_to_cases(table, shapes.case_ids))
    matrix, tested = design.matrix, design.places("group")
    modes = modes_carried(model, matrix)
    found = model.scores[:, :modes]
    in_mm = model.scores * model.standard_deviations
    own = scores[:, [SHIFTED]]
    (place,) = tested
    return {
        "hotelling": multivariate_test(found, matrix, tested, permutations, generator).p,
        "procrustes": procrustes_test(in_mm, matrix, tested, permutations, generator).p,
        "true_score": float(mode_tests(own, matrix, tested, permutations, generator)[0]),
        "hotelling_theory": power(shift, matrix, place, modes, 0.01),
        "true_score_theory": power(shift, matrix, place, 1, 0.01),
        "modes": modes,
    }


if __name__ == "__main__":
    main()

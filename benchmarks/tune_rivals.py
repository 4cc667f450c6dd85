"""Choose the settings of the plain registrations, on development phantoms and on nothing else.

    python benchmarks/tune_rivals.py [--cases 4] [--vertices 2000] [--only cpd nricp]

For each candidate: mean distance between where a registration puts the template's true points on a
case and where they are, ×100 over the case's √area, over the cohorts of the development seeds of
both families. The candidates are the grids below; the smallest mean is the default in
`baselines/settings.py`.
"""

from __future__ import annotations

import argparse
import itertools
import time

import numpy as np

from ssm_pipeline.baselines.register import register
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.data_prep.matching_sets.remeshed_phantoms import remeshed_phantoms
from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.phantoms import draw_truth
from ssm_pipeline.geometry.surface import area

GRIDS: dict[str, list[dict[str, object]]] = {
    "affine nearest": [{}],
    "cpd": [
        {"cpd_width": width, "cpd_strength": strength}
        for width, strength in itertools.product((1.2, 2.0, 3.0, 5.0), (2.0, 8.0, 30.0))
    ],
    "nricp": [
        {"nricp_smoothness": smoothness, "nricp_normals": normals}
        for smoothness in (
            (1e-1, 3e-2, 1e-2),
            (1e-1, 3e-2, 1e-2, 3e-3),
            (1e-1, 3e-2, 1e-2, 3e-3, 1e-3),
            (3e-2, 1e-2, 3e-3),
            (3e-2, 1e-2, 3e-3, 1e-3),
            (1e-2, 3e-3, 1e-3),
            (3e-3, 1e-3),
            (1.0, 3e-1, 1e-1, 3e-2),
        )
        for normals in (0.0, 0.5)
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=4, help="a cohort, its template among them")
    parser.add_argument("--vertices", type=int, default=2000)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(DEVELOPMENT))
    parser.add_argument("--only", nargs="*", default=list(GRIDS))
    arguments = parser.parse_args()
    cohorts = {}
    for family, seed in itertools.product(("lung", "tube"), arguments.seeds):
        truth = draw_truth(PhantomSettings(family=family, cases=arguments.cases, seed=seed))
        counts = [arguments.vertices + 50 * number for number in range(arguments.cases)]
        cohorts[family, seed] = remeshed_phantoms(truth, counts)
    for registration, grid in GRIDS.items():
        for candidate in grid if registration in arguments.only else []:
            settings = RegistrationSettings.model_validate(candidate)
            start, errors = time.process_time(), {}
            for (family, seed), found in cohorts.items():
                template, own = found.meshes[0], found.template_to_shape[0]
                for case, true in zip(found.meshes[1:], found.template_to_shape[1:], strict=True):
                    points = register(template, case, registration, settings, None, 0).points_on(
                        case
                    )
                    off = np.linalg.norm(points[own] - case.vertices[true], axis=1).mean()
                    size = np.sqrt(area(case.vertices, case.faces))
                    errors[family, seed, case.case_id] = 100 * off / size
            per_case = (time.process_time() - start) / len(errors)
            families = {
                name: np.mean([e for (family, *_), e in errors.items() if family == name])
                for name in ("lung", "tube")
            }
            print(
                f"{registration:16s} {candidate!s:70s} lung {families['lung']:.2f} "
                f"tube {families['tube']:.2f} mean {np.mean(list(families.values())):.3f} "
                f"{per_case:.1f} s per case",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""Apply plausible mistakes to a copy of the code, one at a time, and report which no test notices.

    python tools/mutants.py            # all; takes minutes, for a nightly run
    python tools/mutants.py specificity paired

Each mutant is a file, a text in it, the text that replaces it, and the tests that must fail then.
Words on the command line select the mutants whose file contains one of them. The exit status is 1
if a mutant survives, or if its text is no longer in the file: update the list then.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COPIED = ("ssm_pipeline", "data_prep", "tests", "workflows", "conftest.py", "pyproject.toml")
SECONDS = 900  # of the tests of one mutant


@dataclass(frozen=True)
class Mutant:
    file: str
    old: str
    new: str
    tests: str

    @property
    def name(self) -> str:
        return f"{self.file}: {self.old.strip()[:60]} -> {self.new.strip()[:60]}"


MUTANTS = (
    Mutant(
        "ssm_pipeline/evaluation/evaluate.py",
        "held_out_folds(len(frames), settings.folds, seed, groups)",
        "held_out_folds(len(frames), settings.folds, seed)",
        "tests/evaluation/test_evaluate.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/specificity_jackknife.py",
        "cohort.of_the_others(np.flatnonzero(whose == name))",
        "cohort.of_the_others(np.array([], dtype=int))",
        "tests/evaluation/test_paired.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/surface_fits.py",
        "cohort.without(held_out)",
        "(cohort.of_the_others(held_out[:0])[0], cohort.without(held_out)[1])",
        "tests/evaluation/test_evaluate.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/paired.py",
        "stats.t.ppf(0.975, count - 1)",
        "stats.t.ppf(0.975, len(drawn) - 1)",
        "tests/evaluation/test_paired.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/unseen.py",
        "generator.permutation(kept)[: len(held_out)]",
        "generator.permutation(kept)",
        "tests/evaluation/test_paired.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/specificity.py",
        "result[index] = min(found)",
        "result[index] = np.min(found, axis=0)",
        "tests/evaluation/test_specificity.py",
    ),
    Mutant(
        "ssm_pipeline/evaluation/tables.py",
        'holm(added["p"].to_numpy())',
        'added["p"].to_numpy()',
        "tests/evaluation",
    ),
    Mutant(
        "ssm_pipeline/statistics/compare.py",
        "q = false_discovery_control(p)",
        "q = p",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/statistics/compare.py",
        "false_discovery_control(at_vertices),",
        "at_vertices,",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/statistics/compare.py",
        "step * coefficients(vertices",
        "coefficients(vertices",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/statistics/compare.py",
        "step * low[mode]",
        "low[mode]",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/statistics/permutation.py",
        "return (1 + exceeded) / (1 + permutations)",
        "return exceeded / permutations",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/statistics/permutation.py",
        "yield self.without_nuisance(self.residuals[order])",
        "yield self.residuals[order]",
        "tests/statistics/test_compare.py",
    ),
    Mutant(
        "ssm_pipeline/fitting/patient.py",
        "* spread.score_inflation * fitted.score_sd",
        "* fitted.score_sd",
        "tests/fitting/test_patient.py",
    ),
    Mutant(
        "ssm_pipeline/fitting/patient.py",
        "            yardstick.patients,\n",
        "            None,\n",
        "tests/fitting/test_patient.py",
    ),
    Mutant(
        "ssm_pipeline/fitting/model_fit.py",
        "seen = ~lies_on_border(found, self.surface.faces, self.border) & (facing > OPPOSED)",
        "seen = facing > OPPOSED",
        "tests/fitting/test_model_fit.py",
    ),
    Mutant(
        "ssm_pipeline/matching/spectral_loss.py",
        "_off_identity(C_xy @ C_yx)",
        "_off_identity(C_xy @ C_yx.T)",
        "tests/matching",
    ),
    Mutant(
        "ssm_pipeline/matching/spectral_loss.py",
        "(C_xy - pair.P_xy)",
        "(C_xy - pair.P_yx)",
        "tests/matching",
    ),
    Mutant(
        "ssm_pipeline/training/train.py",
        'Pairs(families or [""] * len(bases), seed)',
        'Pairs(families or [""] * len(bases), 0)',
        "tests/training",
    ),
    Mutant(
        "data_prep/cohorts/sides.py",
        "direction=flip[:, None] * case.direction",
        "direction=flip * case.direction",
        "tests/data_prep",
    ),
    Mutant(
        "ssm_pipeline/comparison/anatomy.py",
        "if is_mirrored(mesh.case_id, mirrored):",
        "if False:",
        "tests/comparison",
    ),
    Mutant(
        "ssm_pipeline/meshing/mask_to_mesh.py",
        "settings.laplacian_steps)",
        "10)",
        "tests/meshing",
    ),
    Mutant(
        "ssm_pipeline/engine/per_case.py",
        "result.key != task.key or storage.not_as_written(path.parent, result.files)",
        "result.key != task.key",
        "tests/engine",
    ),
    Mutant(
        "data_prep/formats/organ_masks.py",
        "image.labels > threshold",
        "image.labels >= threshold",
        "tests/data_prep/formats",
    ),
)


def outcome(mutant: Mutant, copy: Path) -> str:
    """ "noticed", "SURVIVES", or "NOT FOUND" for a text that is no longer in the file."""
    path = copy / mutant.file
    text = path.read_text(encoding="utf-8")
    if mutant.old not in text:
        return "NOT FOUND"
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    words = ["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *mutant.tests.split()]
    environment = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    try:
        result = subprocess.run(
            [sys.executable, "-m", "pytest", *words],
            cwd=copy,
            env=environment,
            capture_output=True,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "noticed (the tests did not end)"
    finally:
        path.write_text(text, encoding="utf-8")
    return {0: "SURVIVES", 1: "noticed"}.get(result.returncode, f"pytest ended {result.returncode}")


def main(words: list[str]) -> int:
    chosen = [m for m in MUTANTS if not words or any(word in m.file for word in words)]
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(source, copy / name, symlinks=True, ignore=ignored)
            else:
                shutil.copy2(source, copy / name)
        for mutant in chosen:
            found = outcome(mutant, copy)
            bad += not found.startswith("noticed")
            print(f"{found:<10} {mutant.name}", flush=True)
    print(f"{len(chosen) - bad} of {len(chosen)} noticed")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""How well does a model fit lungs it has never seen, whole, without a third, and of another kind?

    workflow run luna16 --data /where/luna16/is --set "data.exclude={<case>: held out, ...}"
    python benchmarks/new_patients.py runs/luna16 --data /where/luna16/is [--organ other.nii.gz]

The cases that the run excludes are fitted by the model and by the matcher, beside the model's own
cases, each left out. Then what is none of its kind: the right lung of the first, that lung upside
down and mirrored, and another organ. Then each without its top third, as an image that ends there
would show it: how far the completed surface lies from the part removed, beside the mean shape laid
on the rest, and how many of the vertices that were not seen the stated 90 % intervals hold.

    python benchmarks/new_patients.py runs/luna16 --data /where/luna16/is --own

The intervals alone, on the model's own cases, each completed by the others: to choose by.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline.commands.fit_patients import (
    cases_to_judge_by,
    matched_to_template,
    patient_surface,
    reference_of,
)
from ssm_pipeline.data_prep.cohorts import luna16
from ssm_pipeline.data_prep.cohorts.selection import Choice
from ssm_pipeline.data_prep.formats.images import read_organ
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.fitting.completion import calibrated_radius, fits_of_parts
from ssm_pipeline.fitting.cross_validation import CrossValidation
from ssm_pipeline.fitting.model_fit import fit_model
from ssm_pipeline.fitting.patient import FitReport, fit_patient
from ssm_pipeline.fitting.pose_search import start_poses
from ssm_pipeline.fitting.yardstick import Yardstick
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.records import Mask, Mesh
from ssm_pipeline.runs.run import Run, load_run
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import FolderData
from ssm_pipeline.study.study import read_run_settings

MIRROR = np.array([-1.0, 1.0, 1.0])
REMOVED = 1 / 3  # of the height
JOBS = 1  # so that this process's own time is all that was spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", type=Path, required=True, help="LUNA16's masks")
    parser.add_argument("--organ", type=Path, help="a label image of another organ, labels 1 and 2")
    parser.add_argument("--own", action="store_true", help="intervals on the model's own cases")
    arguments = parser.parse_args()
    lab = Lab(arguments.run)
    if arguments.own:
        print(lab.own_intervals().to_string(index=False, float_format="%.2f"))
        return
    masks = {name: lung(arguments.data, name, luna16.LEFT) for name in lab.held_out}
    tables = {
        "whole": lab.whole(masks),
        "of another kind": lab.strange(masks, arguments.data, arguments.organ),
        "without the top third": lab.partial(masks),
    }
    for title, table in tables.items():
        print(f"\n{title}\n{table.to_string(index=False, float_format='%.2f')}")


class Lab:
    """A run's model, with what fits are judged by."""

    def __init__(self, folder: Path) -> None:
        terminal = Terminal()
        self.run: Run = load_run(folder)
        self.settings: StudySettings = read_run_settings(folder)
        self.model: ShapeModel = self.run.model
        self.shapes, self.meshes, self.patients = cases_to_judge_by(
            self.run, self.settings, terminal
        )
        start = time.process_time()
        self.reference: CrossValidation = reference_of(
            self.run, self.shapes, self.meshes, self.patients, self.settings, JOBS, terminal
        )
        print(
            f"the model's own cases, each left out: {time.process_time() - start:.0f} core seconds"
        )

    @property
    def held_out(self) -> tuple[str, ...]:
        data = self.settings.data
        if not isinstance(data, FolderData) or not data.exclude:
            raise SystemExit("the run excludes no case; see --help")
        return tuple(data.exclude)

    def fitted(self, surface: Mesh, matched: np.ndarray | None = None) -> FitReport:
        yardstick = Yardstick(
            self.model, self.shapes, self.meshes, self.reference, patients=self.patients
        )
        return fit_patient(yardstick, surface, matched, self.settings.seed, JOBS)

    def whole(self, masks: dict[str, Mask]) -> pd.DataFrame:
        """Both ways of fitting, and the range of the model's own cases."""
        rows = []
        for case_id, mask in masks.items():
            for by in ("model", "matcher"):
                start, core = time.perf_counter(), time.process_time()
                surface = patient_surface(mask, self.settings)
                matched = None
                if by == "matcher":
                    matched = matched_to_template(self.run, self.settings, surface)
                report = self.fitted(surface, matched)
                rows.append(
                    {
                        "case": case_id[-6:],
                        "by": by,
                        "seconds": time.perf_counter() - start,
                        "core_seconds": time.process_time() - core,
                        "mean_mm": report.mean_mm,
                        "hd95_mm": report.hd95_mm,
                        "residual_mm": report.typicality.residual.value,
                        "mahalanobis_sd": report.typicality.mahalanobis.value,
                        "scores_1_to_3": np.array2string(report.scores[:3], precision=1),
                        "within_90_percent": 100 * (report.distances_mm <= report.radius_mm).mean(),
                        "flags": _flags(report),
                    }
                )
        for name, choose in (("own: least", np.min), ("median", np.median), ("most", np.max)):
            rows.append(
                {
                    "case": name,
                    "by": "model",
                    "residual_mm": choose(self.reference.residual_mm),
                    "mahalanobis_sd": choose(self.reference.mahalanobis),
                }
            )
        return pd.DataFrame(rows)

    def strange(self, masks: dict[str, Mask], data: Path, organ: Path | None) -> pd.DataFrame:
        case_id, mask = next(iter(masks.items()))
        right = lung(data, case_id, luna16.RIGHT)
        down = np.diag([1.0, -1.0, -1.0])
        upside_down = dataclasses.replace(
            mask, origin_mm=down @ mask.origin_mm, direction=down @ mask.direction
        )
        offered = {"itself": mask, "right": right, "upside down": upside_down}
        offered["mirrored"] = dataclasses.replace(
            mask, origin_mm=mask.origin_mm * MIRROR, direction=MIRROR[:, None] * mask.direction
        )
        if organ is not None:
            offered["another organ"] = read_organ(organ, (1, 2), "organ")
        rows = []
        for name, one in offered.items():
            report = self.fitted(patient_surface(one, self.settings))
            judged = report.typicality
            rows.append(
                {
                    "offered": name,
                    "residual_mm": judged.residual.value,
                    "threshold_mm": judged.residual.threshold,
                    "mahalanobis_sd": judged.mahalanobis.value,
                    "turned_deg": judged.turned_deg,
                    "mirror_ratio": judged.mirror_ratio,
                    "flags": _flags(report),
                }
            )
        return pd.DataFrame(rows)

    def partial(self, masks: dict[str, Mask]) -> pd.DataFrame:
        rows = []
        for case_id, mask in masks.items():
            whole = patient_surface(mask, self.settings)
            part = patient_surface(without_top(mask), self.settings)
            core = time.process_time()
            report = self.fitted(part)
            row = {"case": case_id[-6:], "core_seconds": time.process_time() - core}
            mean = self._mean_laid_on(part)
            unseen = ~report.observed
            rows.append(
                row
                | completion(whole, report.vertices, unseen, report.radius_mm, self.model.faces)
                | {"mean_laid_on_mm": _removed_mm(whole, mean, self.model.faces)}
            )
        return pd.DataFrame(rows)

    def own_intervals(self) -> pd.DataFrame:
        """Each of the model's own cases without its top third, completed by the others, with the
        intervals that the others' errors make."""
        height = (self.model.mean @ self.reference.upright.T)[:, 2]
        observed = height < height.max() - REMOVED * np.ptp(height)
        fits = fits_of_parts(self.shapes, self.meshes, observed, seed=self.settings.seed, jobs=JOBS)
        rows = []
        for index, case_id in enumerate(self.shapes.case_ids):
            others = np.delete(np.arange(len(self.meshes)), index)
            errors = fits.distances_mm[index]
            radius = calibrated_radius(fits.stated_mm2[index], fits.of(others), observed)
            rows.append(
                {
                    "case": case_id[-6:],
                    "error_mm": errors[~observed].mean(),
                    "radius_mm": np.median(radius[~observed]),
                    "within_90_percent": 100 * (errors <= radius)[~observed].mean(),
                    "of_the_seen_percent": 100 * (errors <= radius)[observed].mean(),
                }
            )
        mean = {"case": "mean"} | dict(pd.DataFrame(rows).drop(columns="case").mean())
        return pd.DataFrame([*rows, mean])

    def _mean_laid_on(self, part: Mesh) -> np.ndarray:
        """(V, 3) mm: the mean shape where it fits the part best, as `fit` does with no mode to
        bend it."""
        start = start_poses(self.model, part, self.reference.upright, self.settings.seed)[0].frame
        stiff = dataclasses.replace(self.model.truncate(1), variances=np.array([1e-9]))
        return fit_model(stiff, part, start, seed=self.settings.seed).vertices


def lung(data: Path, case_id: str, label: int) -> Mask:
    (case,) = luna16.find_cases(data, choice=Choice(cases=(case_id,))).cases
    return read_organ(case.files[0], (label,), case_id, "lung")


def without_top(mask: Mask) -> Mask:
    """The image ends below the top third of the organ's height."""
    z = np.flatnonzero(mask.voxels.any(axis=(1, 2)))
    height = (z[-1] - z[0] + 1) * REMOVED
    if np.asarray(mask.direction)[2, 2] > 0:  # slices from the feet up
        return dataclasses.replace(mask, voxels=mask.voxels[: int(z[-1] + 1 - height)])
    first = int(z[0] + height)
    origin = mask.to_world(np.array([0.0, 0.0, first]))
    return dataclasses.replace(mask, voxels=mask.voxels[first:], origin_mm=origin)


def completion(
    whole: Mesh, vertices: np.ndarray, unseen: np.ndarray, radius: np.ndarray, faces: np.ndarray
) -> dict[str, float]:
    errors = SurfaceTarget.of(whole.vertices, whole.faces).distances_to(vertices)
    return {
        "unseen_percent": 100 * float(unseen.mean()),
        "removed_mm": _removed_mm(whole, vertices, faces),
        "radius_mm": float(np.median(radius[unseen])),
        "within_90_percent": 100 * float((errors <= radius)[unseen].mean()),
    }


def _removed_mm(whole: Mesh, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Mean distance from the removed part of a surface to a completed one."""
    height = whole.vertices[:, 2]
    removed = height > height.max() - REMOVED * np.ptp(height)
    return float(SurfaceTarget.of(vertices, faces).distances_to(whole.vertices)[removed].mean())


def _flags(report: FitReport) -> str:
    return ", ".join(flag.split(":")[0] for flag in report.typicality.flags)


if __name__ == "__main__":
    main()

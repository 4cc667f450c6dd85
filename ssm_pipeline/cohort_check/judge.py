"""What is striking of a case among the others, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.cohort_check.fingerprint import log_spectra
from ssm_pipeline.cohort_check.rigid_fit import FAR_DEG

STRIKING_Z = 5.0  # robust standard deviations
FEWEST = 5  # cases: of fewer, nothing can be said of "the others"
ORDINARY = 1.15  # a case this much off is never striking, however alike the others are
MIRRORED = 0.95  # of the distance as it is: the mirror image lies that much better
HANDED = 1.1  # mirror images lie that much worse, or this organ's sides can't be told apart
TURNED = 1.25  # as much worse it lies within FAR_DEG than turned further
_UNITS = {10: "centimetres", 100: "a unit 100 times", 1000: "metres", 25.4: "inches"}


def robust_z(values: np.ndarray) -> np.ndarray:
    """(N,) deviations from the median in units of 1.4826 times the median absolute deviation.

    Of logarithms: a spread below log(ORDINARY) / STRIKING_Z counts as that much.

    >>> float(robust_z(np.log([1.0, 1.1, 0.9, 1.0, 10.0])).round()[-1])
    16.0
    """
    away = values - np.median(values)
    spread = 1.4826 * float(np.median(np.abs(away)))
    result: np.ndarray = away / max(spread, float(np.log(ORDINARY)) / STRIKING_Z)
    return result


def is_handed(mirrored_ratios: np.ndarray) -> bool:
    """Whether the cohort's mirror images can be told: most lie clearly worse, or clearly better.

    Args:
        mirrored_ratios: (N,) distance of the mirror image over the distance as it is. True of a
            cohort of both sides, too.
    """
    sizes = np.abs(np.log(mirrored_ratios))
    middle = float(np.median(sizes))
    spread = 1.4826 * float(np.median(np.abs(sizes - middle)))
    return len(sizes) >= FEWEST and middle > max(np.log(HANDED), 3 * spread)


def judge(table: pd.DataFrame, twins: Sequence[tuple[str, str, str]] = ()) -> pd.DataFrame:
    """The cohort check's table: numbers, robust z-scores, and remarks where a case is striking.

    Args:
        table: A row per case: case_id, the numbers of `fingerprint` and of `fit_to`, and
            left_out_percent: what of its mask or surface was left out as separate pieces.
        twins: (case, other case, "the same" or "the mirror image").

    Returns:
        case_id, volume_ml, area_cm2, size_z, compactness_z, spectrum_z, fit_percent, fit_z,
        mirrored_ratio (below 1: the mirror image fits better), turned_deg, left_out_percent,
        remarks ("" where nothing is striking).
    """
    remarks: dict[str, list[str]] = {case_id: [] for case_id in table["case_id"]}
    volumes = table["volume_ml"].to_numpy(float)
    spectra = log_spectra(table)
    from_middle = np.abs(spectra - np.median(spectra, axis=0)).mean(axis=1)
    result = pd.DataFrame(
        {
            "case_id": table["case_id"],
            "volume_ml": volumes,
            "area_cm2": table["area_cm2"],
            "size_z": robust_z(np.log(volumes)),
            "compactness_z": robust_z(np.log(table["compactness"].to_numpy(float))),
            "spectrum_z": robust_z(np.log(from_middle + 0.01)),
            "fit_percent": table["fit_percent"],
            "fit_z": robust_z(np.log(table["fit_percent"].to_numpy(float))),
            "mirrored_ratio": table["mirrored_percent"] / table["fit_percent"],
            "turned_deg": table["turned_deg"],
            "left_out_percent": table["left_out_percent"],
        }
    )
    worse_near = (table["near_percent"] / table["fit_percent"]).to_numpy()
    turned = (result["turned_deg"].to_numpy() > FAR_DEG) & (worse_near > TURNED)
    lie_alike = turned.mean() < 0.5
    handed = is_handed(result["mirrored_ratio"].to_numpy(float))
    for index, row in result.iterrows():
        told = remarks[row["case_id"]]
        if len(result) >= FEWEST:
            told += _size_remarks(row, float(np.median(volumes)))
            told += _shape_remarks(row)
        if handed and row["mirrored_ratio"] < MIRRORED:
            told.append(
                f"mirrored: its mirror image lies {1 / row['mirrored_ratio']:.2f} times closer to "
                "the others; the other side, or a left-handed image"
            )
        if turned[int(index)] and lie_alike:
            told.append(f"turned: it lies best at {row['turned_deg']:.0f}° to the others")
        if row["left_out_percent"] >= 1:
            told.append(f"several pieces: {row['left_out_percent']:.0f} % of it was left out")
    for one, other, what in twins:
        remarks[one].append(f"{what} as {other}" if what == "the same" else f"{what} of {other}")
        remarks[other].append(f"{what} as {one}" if what == "the same" else f"{what} of {one}")
    result["remarks"] = ["; ".join(remarks[case_id]) for case_id in result["case_id"]]
    return result


def _size_remarks(row: pd.Series, middle_ml: float) -> list[str]:
    if abs(row["size_z"]) < STRIKING_Z:
        return []
    times = (row["volume_ml"] / middle_ml) ** (1 / 3)
    text = f"size: {row['volume_ml']:.3g} ml, the median is {middle_ml:.3g} ml"
    for factor, name in _UNITS.items():
        if abs(np.log(max(times, 1 / times) / factor)) < np.log(1.3):
            whose = name if times < 1 else f"are the others in {name}"
            return [f"{text}; lengths are {times:.2g} times the others': {whose}?"]
    return [text]


def _shape_remarks(row: pd.Series) -> list[str]:
    told = []
    if row["compactness_z"] <= -STRIKING_Z:
        told.append(f"flat or ragged: compactness {row['compactness_z']:.1f} robust SD")
    far = [name for name in ("spectrum", "fit") if row[f"{name}_z"] >= STRIKING_Z]
    if far:
        scores = ", ".join(f"{name} {row[f'{name}_z']:.1f}" for name in far)
        told.append(f"another shape: {scores} robust SD; another organ, or a failed segmentation?")
    return told

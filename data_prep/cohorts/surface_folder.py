"""A folder of surfaces of any organ, one file per case."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ssm_pipeline.data_prep.cohorts.case_names import case_name, patient_of, told_apart
from ssm_pipeline.data_prep.cohorts.selection import (
    ALL,
    Choice,
    choose,
    cohort_of,
    files_below,
    unique_by_id,
)
from ssm_pipeline.data_prep.cohorts.sides import mirror_side
from ssm_pipeline.data_prep.formats.organ_size import MM_OF, Unit, check_size, diagonal_of
from ssm_pipeline.data_prep.formats.surface_files import (
    RAS_TO_LPS,
    SURFACE_FORMATS,
    is_surface,
    read_triangles,
    surface_stem,
)
from ssm_pipeline.records import CaseError, CaseSource, Cohort, Surface

Space = Literal["LPS", "RAS"]


def find_cases(
    folder: Path,
    pattern: str | None = None,
    unit: Unit | None = None,
    space: Space | None = None,
    choice: Choice = ALL,
) -> Cohort:
    """The surfaces of a folder; nothing is read before a case is loaded.

    Args:
        pattern: A glob below `folder`; None: every surface directly in it. `case_name` tells the
            ids.
        unit, space: As `read_surface` takes them.

    Raises:
        StudyError: If nothing matches, two files share one id, or a named case is missing.
    """
    files = files_below(folder, pattern, is_surface, f"surfaces ({SURFACE_FORMATS})")
    names = [
        case_name(path, surface_stem(path), pattern, choice.mirror is not None) for path in files
    ]
    names = told_apart(names, [path.relative_to(folder) for path in files])
    by_id = unique_by_id(zip(names, files, strict=True))
    sources = [
        CaseSource(
            case_id,
            (path,),
            partial(read_surface, path, case_id, unit, space),
            patient_of(case_id),
        )
        for case_id, path in choose(by_id, choice).items()
    ]
    return cohort_of(folder.name, mirror_side(sources, choice.mirror), choice)


def read_surface(
    path: Path, case_id: str, unit: Unit | None = None, space: Space | None = None
) -> Surface:
    """Read one file as a Surface in mm LPS.

    Args:
        unit: Of the file's numbers. None: taken as millimetres, if the size could be an organ's.
        space: Of a file that does not say it (`SPACE=RAS` in its header); None: LPS.

    Raises:
        CaseError: For a file that can't be read, says another space than `space`, or, without
            `unit`, has a size that no organ has in millimetres.
    """
    vertices, faces, stated = read_triangles(path, case_id)
    if space is not None and stated is not None and stated != space:
        raise CaseError(
            case_id,
            f"{path.name} says that its coordinates are {stated}, and data.space says {space}. "
            "Leave data.space out: files that say their space are read by what they say.",
        )
    points = np.asarray(vertices, float) * MM_OF[unit or "mm"]
    if (stated or space) == "RAS":
        points = points * RAS_TO_LPS
    surface = Surface(points, faces, case_id)
    if unit is None:
        check_size(diagonal_of(points[np.unique(faces)]), case_id, path.name)
    return surface

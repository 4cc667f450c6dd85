"""A comparison as files, tables for other programs among them, and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ssm_pipeline import storage
from ssm_pipeline.statistics.compare import ShapeComparison, VertexMap
from ssm_pipeline.statistics.covariates import design_of

ABOUT_FILE = "compare.json"
TABLES = ("tests", "modes", "power")
ARRAYS = ("displacement_mm", "p", "q")  # of a map


def write_comparison(result: ShapeComparison, folder: Path, model_key: str) -> None:
    """tests.csv, modes.csv, power.csv, covariates.csv, vertex_maps.npz, and compare.json: what was
    asked, and of which model."""
    tables = {name: getattr(result, name) for name in TABLES}
    tables["covariates"] = result.design.covariates
    for name, table in tables.items():
        storage.write_table(table, folder / f"{name}.csv")
    arrays = {
        f"{name}_{index}": getattr(one, name)
        for index, one in enumerate(result.maps)
        for name in ARRAYS
    }
    storage.save_arrays(arrays, folder / "vertex_maps.npz", compressed=True)
    about = {
        "formula": result.design.formula,
        "cases": len(result.design.matrix),
        "columns": [vars(column) for column in result.design.columns],
        "modes_tested_together": result.mode_count,
        "maps": [one.name for one in result.maps],
        "tests": json.loads(result.tests.to_json(orient="records")),
        "model_key": model_key,
    }
    storage.write_json(folder / ABOUT_FILE, about)


def read_comparison(folder: Path) -> ShapeComparison:
    """What `write_comparison` wrote.

    Raises:
        DamagedFile: Where a file is missing or damaged.
    """
    about: dict[str, Any] = storage.read_json(folder / ABOUT_FILE)
    tables = {name: storage.read_table(folder / f"{name}.csv") for name in TABLES}
    covariates = storage.read_table(folder / "covariates.csv", text=["case_id"])
    arrays = storage.load_arrays(folder / "vertex_maps.npz")
    with storage.damage_named(folder / ABOUT_FILE):
        return ShapeComparison(
            design_of(about["formula"], covariates),
            about["modes_tested_together"],
            **tables,
            maps=tuple(
                VertexMap(name, **{array: arrays[f"{array}_{index}"] for array in ARRAYS})
                for index, name in enumerate(about["maps"])
            ),
        )

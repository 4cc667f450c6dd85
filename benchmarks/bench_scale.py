"""What a case costs as cohorts grow: phantom surfaces of few vertices, every stage of a study.

    python benchmarks/bench_scale.py                        25, 100 and 400 cases, one process
    python benchmarks/bench_scale.py --cases 25 100 400 1600
    python benchmarks/bench_scale.py --to docs/scale        a plot and a table

Seconds are of the processor, so that other work on the machine does not count. From the slopes
between the two largest cohorts follow those of 10 000 and 100 000 cases, of shapes as small.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import trimesh
from scipy.spatial.transform import Rotation

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.stage import Outcome, Stage, StageContext
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.settings import StudySettings

PER_CASE = ("meshing", "cohort_check", "spectral", "correspondence", "groupwise")
ON_ONE_MACHINE = ("evaluation",)  # by as many processes as it has cores
PROJECTED = (10_000, 100_000)
MACHINES, CORES = (1, 4, 16, 64), 16


def write_phantoms(folder: Path, cases: int) -> None:
    """Ellipsoids of 162 vertices with smooth random bumps, each turned and moved a little."""
    folder.mkdir()
    ball, generator = trimesh.creation.icosphere(2), np.random.default_rng(0)
    directions = generator.normal(size=(8, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bumps = np.exp(4 * (ball.vertices @ directions.T - 1))
    for number in range(cases):
        radius = 1 + bumps @ generator.normal(0, 0.1, 8)
        vertices = ball.vertices * radius[:, None] * generator.normal([30, 38, 48], 2)
        turn = Rotation.from_rotvec(generator.normal(0, 0.1, 3))
        vertices = turn.apply(vertices) + generator.normal(0, 5, 3)
        trimesh.Trimesh(vertices, ball.faces).export(folder / f"case_{number:06d}.ply")


def settings(surfaces: Path) -> StudySettings:
    return StudySettings.model_validate(
        {
            "data": {"source": "meshes", "folder": surfaces, "unit": "mm"},
            "meshing": {"faces": 320},
            "spectral": {"eigenpairs": 20},
            "training": {
                "steps": 20,
                "faces": 320,
                "matching": {"channels": 16, "width": 16, "blocks": 1, "descriptors": 16},
                "interpolation": {"width": 8, "blocks": 1},
            },
            "adaptation": {"samples": 500, "steps": 3, "path_times": 3},
            "groupwise": {"rounds": 1},
            "evaluation": {
                "points": 200,
                "samples": 100,
                "surface_samples": 20,
                "surface_points": 100,
                "screening_points": 64,
                "mode_counts": 4,
                "bootstrap_draws": 1000,
            },
            "comparison": {"methods": []},
            "report": {"modes": 2, "case_faces": 300, "paths": 1, "tile_px": 64},
        }
    )


def run_one(cases: int, runs: Path, table: Path) -> None:
    """One cohort, in this process alone: cases, stage, seconds (processor), peak_mb."""
    seconds: dict[str, float] = {}

    def timed(stage: Stage[StudySettings]) -> Stage[StudySettings]:
        def work(context: StageContext[StudySettings]) -> Outcome:
            start = time.process_time()
            outcome = stage.work(context)
            seconds[stage.name] = time.process_time() - start
            return outcome

        return dataclasses.replace(stage, work=work)

    surfaces = runs / f"surfaces-{cases}"
    write_phantoms(surfaces, cases)
    stages = tuple(timed(stage) for stage in STAGES)
    folder = run_study(f"n{cases}", settings(surfaces), RunOptions(runs), Terminal(), stages)
    rows = [
        {
            "cases": cases,
            "stage": record.stage,
            "seconds": seconds[record.stage],
            "peak_mb": record.peak_memory_mb,
        }
        for record in load_run(folder).stages
    ]
    pd.DataFrame(rows).to_csv(table, index=False)


def slopes(found: pd.DataFrame) -> pd.DataFrame:
    """A row a stage: its seconds and memory, and how they grow from the last cohort but one to the
    last: seconds as a power of the cases, memory as MB a case."""
    small, large = sorted(found["cases"].unique())[-2:]
    rows = []
    for stage, group in found.groupby("stage", sort=False):
        at = group.set_index("cases")
        power = math.log(at["seconds"][large] / at["seconds"][small]) / math.log(large / small)
        a_case = (at["peak_mb"][large] - at["peak_mb"][small]) / (large - small)
        rows.append(
            {"stage": stage}
            | {f"s a case, {n}": at["seconds"][n] / n for n in at.index}
            | {"power": power, "seconds": at["seconds"][large]}
            | {"peak_mb": at["peak_mb"][large], "mb_a_case": max(a_case, 0.0)}
        )
    return pd.DataFrame(rows)


def projection(table: pd.DataFrame, large: int, cases: int) -> dict[str, Any]:
    """Hours of one core, and of so many machines; GB of the process that holds all cases."""
    hours = table["seconds"] * (cases / large) ** table["power"].clip(lower=0) / 3600
    shared, on_one = table["stage"].isin(PER_CASE), table["stage"].isin(ON_ONE_MACHINE)
    alone = hours.where(~on_one, hours / CORES)[~shared]
    memory = (table["peak_mb"] + table["mb_a_case"] * (cases - large)) / 1024
    row: dict[str, Any] = {"cases": cases, "core hours": float(hours.sum())}
    for machines in MACHINES:
        row[f"hours, {machines} x {CORES} cores"] = float(hours[shared].sum()) / (
            machines * CORES
        ) + float(alone.sum())
    row |= {
        "hours on one machine": float(alone.sum()),
        "most of them": table["stage"][alone.idxmax()],
    }
    row |= {"GB": float(memory.max()), "most in": table["stage"][memory.idxmax()]}
    return row


def plot(found: pd.DataFrame, path: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for stage, group in found.groupby("stage", sort=False):
        left.plot(group["cases"], group["seconds"] / group["cases"], "o-", label=stage, ms=3)
        right.plot(group["cases"], group["peak_mb"], "o-", ms=3)
    left.set(xscale="log", yscale="log", xlabel="cases", ylabel="seconds a case")
    right.set(xscale="log", xlabel="cases", ylabel="peak memory, MB", ylim=(0, None))
    for axes in (left, right):
        sizes = sorted(found["cases"].unique())
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.minorticks_off()
    figure.legend(loc="outside right center", fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, nargs="+", default=[25, 100, 400])
    parser.add_argument("--to", type=Path, help="folder for scale.svg and scale.csv")
    parser.add_argument("--one", type=Path, nargs=2, help=argparse.SUPPRESS)  # runs, table
    arguments = parser.parse_args()
    if arguments.one:
        run_one(arguments.cases[0], *arguments.one)
        return
    with tempfile.TemporaryDirectory() as name:
        tables = []
        for cases in sorted(arguments.cases):  # a process each, or one's memory is the next one's
            table = Path(name) / f"{cases}.csv"
            words = ["--cases", str(cases), "--one", name, str(table)]
            subprocess.run([sys.executable, __file__, *words], check=True)
            tables.append(pd.read_csv(table))
    found = pd.concat(tables)
    table = slopes(found)
    print(table.to_string(index=False, float_format="%.3g"))
    largest = max(arguments.cases)
    for cases in PROJECTED:
        print()
        for what, value in projection(table, largest, cases).items():
            print(f"{what:<26}{value:.3g}" if isinstance(value, float) else f"{what:<26}{value}")
    if arguments.to:
        arguments.to.mkdir(parents=True, exist_ok=True)
        found.to_csv(arguments.to / "scale.csv", index=False, float_format="%.4g")
        plot(found, arguments.to / "scale.svg")


if __name__ == "__main__":
    main()

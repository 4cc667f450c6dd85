"""Toy stages that write numbers into files: the runner's behaviour without the real work."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.runner import Job
from ssm_pipeline.engine.stage import Outcome, Stage, StageContext
from ssm_pipeline.records import CaseError, CaseSource, Cohort, Mask
from ssm_pipeline.settings import Settings


def no_mask() -> Mask:
    raise AssertionError("the toy stages read the files themselves")


def write_masks(folder: Path, numbers: dict[str, str]) -> None:
    folder.mkdir(exist_ok=True)
    for name, number in numbers.items():
        (folder / f"{name}.txt").write_text(number)


class ToyMeshing(Settings):
    faces: int = 1000


class ToySettings(Settings):
    seed: int = 0
    meshing: ToyMeshing = ToyMeshing()

    def to_yaml(self) -> str:
        return self.model_dump_json()


def toy_job(masks: Path, name: str = "toy", faces: int = 1000, seed: int = 0) -> Job:
    settings = ToySettings(seed=seed, meshing=ToyMeshing(faces=faces))
    return Job(name, settings, f"the masks in {masks}", False, partial(find_toys, masks))


def find_toys(masks: Path, run_folder: Path) -> Cohort:
    paths = sorted(masks.glob("*.txt"))
    return Cohort("toys", tuple(CaseSource(path.stem, (path,), no_mask) for path in paths))


def data_stage(context: StageContext[ToySettings]) -> Outcome:
    return Outcome({case: context.case_key(case) for case in context.case_keys})


def double(case_id: str, source: Path, diary: Path, folder: Path) -> Row:
    """Writes twice the number; "bad" is a case's fault, "bug" ours, "kill" ends the process."""
    with diary.open("a") as file:
        file.write(f"{case_id}\n")
    text = source.read_text()
    if text == "bad":
        raise CaseError(case_id, "no number found; a number is needed.")
    if text == "kill":
        source.write_text("7")
        os.kill(os.getpid(), signal.SIGKILL)
    storage.write_text(folder / "doubled.txt", str(2 * int(text)))
    return {"case_id": case_id, "doubled": 2 * int(text)}


def hold(begun: Path, ended: Path, seconds: float, folder: Path) -> Row:
    """Says when it begins and ends; sleeps in between."""
    begun.touch()
    time.sleep(seconds)
    ended.touch()
    return {}


def take_memory(megabytes: int, folder: Path) -> Row:
    np.empty(megabytes * 2**20, np.uint8)
    return {}


def count_threads(folder: Path) -> Row:
    """How many threads the process has gained when each library has had much to do."""
    import psutil
    import scipy.linalg
    import torch
    from pykdtree.kdtree import KDTree

    points = np.random.default_rng(0).random((100_000, 3), dtype=np.float32)
    square = np.random.default_rng(0).random((1000, 1000))
    work: dict[str, Callable[[], object]] = {
        "pykdtree": lambda: KDTree(points).query(points),
        "scipy": lambda: scipy.linalg.solve(square, square @ square),
        "torch": lambda: torch.from_numpy(square) @ torch.from_numpy(square),
    }
    gained = {}
    for name, do in work.items():
        before = psutil.Process().num_threads()
        do()
        gained[name] = psutil.Process().num_threads() - before
    return gained


def double_stage(context: StageContext[ToySettings], diary: Path) -> Outcome:
    files = {case.case_id: case.files[0] for case in context.cohort.cases}
    tasks = [
        CaseTask(
            case_id,
            context.case_key(case_id, context.settings.meshing),
            partial(double, case_id, files[case_id], diary),
        )
        for case_id in context.case_keys
    ]
    results = context.map_cases(tasks)
    context.write_table("doubled", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def sum_stage(context: StageContext[ToySettings]) -> Outcome:
    total = sum(
        int((context.run_folder / "double" / case / "doubled.txt").read_text())
        for case in context.case_keys
    )
    storage.write_text(context.folder() / "sum.txt", str(total))
    return Outcome(context.case_keys, note=f"sum {total}")


def toy_stages(diary: Path) -> tuple[Stage[ToySettings], ...]:
    return (
        Stage("data", data_stage, lambda settings: {}),
        Stage("double", partial(double_stage, diary=diary), lambda s: s.meshing, ("data",)),
        Stage("sum", sum_stage, lambda s: {"seed": s.seed}, ("double",)),
    )

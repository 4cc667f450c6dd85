"""What `fuzz.py` breaks, II: files that a run leaves, which a disk or a hand may have changed."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
from fuzz_reader import Reader

CASE_KEYS = {"a": "99", "b": "98"}


def write_matcher(folder: Path) -> Path:
    from ssm_pipeline.training.matcher import Matcher
    from ssm_pipeline.training.networks import Networks
    from ssm_pipeline.training.settings import TrainingSettings

    small = {"channels": 8, "width": 8, "blocks": 1, "descriptors": 8}
    settings = TrainingSettings.model_validate(
        {"matching": small, "interpolation": {"width": 8, "blocks": 1}}
    )
    Matcher(Networks.new(settings, 0), settings, 0, ("a", "b"), 8).save(folder / "m.pt")
    return folder / "m.pt"


def read_matcher(path: Path) -> object:
    from ssm_pipeline.training.matcher import load_matcher

    return load_matcher(path)


def write_checkpoint(folder: Path) -> Path:
    import torch

    from ssm_pipeline.training.checkpoint import TrainingCheckpoint, save_checkpoint
    from ssm_pipeline.training.tensor_files import load_tensors

    weights = load_tensors(write_matcher(folder))["networks"]
    adam = torch.optim.Adam([torch.nn.Parameter(torch.zeros(3))]).state_dict()
    save_checkpoint(TrainingCheckpoint(2, weights, adam, [{"total": 1.0}]), folder / "c.pt")
    return folder / "c.pt"


def read_checkpoint(path: Path) -> object:
    from ssm_pipeline.training.checkpoint import load_checkpoint

    return load_checkpoint(path)


def write_mesh(folder: Path) -> Path:
    from ssm_pipeline import storage
    from ssm_pipeline.records import Mesh

    storage.save(Mesh(np.eye(3), np.array([[0, 1, 2]]), "a"), folder / "mesh.npz")
    return folder / "mesh.npz"


def read_mesh_record(path: Path) -> object:
    from ssm_pipeline import storage
    from ssm_pipeline.records import Mesh

    return storage.load(Mesh, path)


def write_model(folder: Path) -> Path:
    from ssm_pipeline.shape_model.model import ShapeModel

    modes = np.linalg.qr(np.random.default_rng(0).standard_normal((12, 2)))[0].T
    ShapeModel(
        mean=np.vstack([np.zeros(3), 10 * np.eye(3)]),
        modes=modes.reshape(2, 4, 3),
        variances=np.array([9.0, 4.0]),
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        scores=np.array([[1.0, 0.5], [-1.0, -0.5]]),
        case_ids=("a", "b"),
    ).save(folder / "model.npz")
    return folder / "model.npz"


def read_model(path: Path) -> object:
    from ssm_pipeline.shape_model.model import load_model

    return load_model(path)


def write_stage(folder: Path) -> Path:
    """stage.json with a file and a case's case.json that it answers for."""
    from ssm_pipeline import storage
    from ssm_pipeline.engine.per_case import CaseTask, run_case
    from ssm_pipeline.engine.stage import StageRecord

    stage = folder / "meshing"

    def work(case: Path) -> dict[str, object]:
        storage.write_text(case / "mesh.txt", "mesh")
        return {"case_id": "a", "faces": 4, "warnings": ["small"]}

    run_case(CaseTask("a", CASE_KEYS["a"], work), stage)
    storage.write_text(stage / "quality.csv", "case_id,faces\na,4\n")
    StageRecord(
        stage="meshing",
        key="5f",
        settings={"faces": 100},
        seed=0,
        inputs={"data": "7a"},
        versions={"numpy": "2"},
        finished_at="2026-01-01T00:00:00+00:00",
        seconds=1.5,
        peak_memory_mb=100.0,
        cases_in=["a", "b"],
        cases_out=["a"],
        dropped=[{"case_id": "b", "stage": "meshing", "reason": "too small"}],
        case_keys=CASE_KEYS,
        files=storage.fingerprints(stage, [stage / "quality.csv", stage / "a" / "case.json"]),
    ).write(stage)
    return stage / "stage.json"


def read_stage(path: Path) -> object:
    """As a second run does, and `workflow verify`."""
    from ssm_pipeline.engine.left_files import damaged_files
    from ssm_pipeline.engine.stage import StageRecord

    record = StageRecord.read(path.parent)
    return record and damaged_files(path.parent, record.files, by_content=True)


def write_case(folder: Path) -> Path:
    return write_stage(folder).parent / "a" / "case.json"


def read_case(path: Path) -> object:
    from ssm_pipeline.engine.per_case import CaseTask, finished_result

    task = CaseTask("a", CASE_KEYS["a"], lambda folder: {})
    return finished_result(task, path.parents[1]), read_stage(path.parents[1] / "stage.json")


def write_owner(folder: Path) -> Path:
    from ssm_pipeline.engine.ownership import take

    run = folder / "toy"
    take(run, "toy", "the masks in /masks", False, CASE_KEYS)
    write_stage(run)
    return run / "study.json"


def read_owner(path: Path) -> object:
    """In a copy, which may be moved aside, and whose cases may be deleted."""
    from ssm_pipeline.engine.ownership import make_room, take

    with tempfile.TemporaryDirectory() as place:
        run = Path(shutil.copytree(path.parent, Path(place) / "toy"))
        make_room(run, "toy", False)
        return take(run, "toy", "the masks in /masks", False, CASE_KEYS)


def write_withdrawn(folder: Path) -> Path:
    from ssm_pipeline.engine.withdrawn import WITHDRAWN_FILE, withdraw

    withdraw(folder, "0" * 32)
    (folder / "mask.nii").write_bytes(b"mask")
    return folder / WITHDRAWN_FILE


def read_withdrawn(path: Path) -> object:
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.engine.withdrawn import without_withdrawn
    from ssm_pipeline.records import CaseSource, Cohort

    case = CaseSource("a", (path.parent / "mask.nii",), lambda: None)  # type: ignore[arg-type, return-value]
    return without_withdrawn(Cohort("toys", (case,)), path.parent, Terminal())


def write_log(folder: Path) -> Path:
    run = folder / "toy"
    write_stage(run)
    events: list[dict[str, object]] = [
        {"event": "run", "study": "toy", "synthetic": False, "data": "masks"},
        {"event": "stage started", "stage": "meshing", "cases": 2},
        {"event": "case", "stage": "meshing", "case_id": "b", "dropped": "too small"},
        {"event": "progress", "label": "meshing", "done": 1, "total": 2},
        {"event": "run stopped", "error": "StudyError: the disk is full"},
    ]
    lines = [
        json.dumps({"time": f"2026-01-01T00:00:{second:02d}+00:00", **event})
        for second, event in enumerate(events)
    ]
    (run / "run.jsonl").write_text("\n".join(lines) + "\n")
    return run / "run.jsonl"


def read_log(path: Path) -> object:
    from ssm_pipeline.commands.run_status import status_lines

    return status_lines(path.parent)


OWN_FILES = (
    Reader("matcher.pt", write_matcher, read_matcher),
    Reader("checkpoint.pt", write_checkpoint, read_checkpoint),
    Reader("record npz", write_mesh, read_mesh_record),
    Reader("model npz", write_model, read_model),
    Reader("stage.json", write_stage, read_stage),
    Reader("case.json", write_case, read_case),
    Reader("study.json", write_owner, read_owner),
    Reader("withdrawn.json", write_withdrawn, read_withdrawn),
    Reader("run.jsonl", write_log, read_log),
)

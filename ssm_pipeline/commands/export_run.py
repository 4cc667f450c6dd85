"""`workflow export`: a finished run's model in the formats that other programs read."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Sequence
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import clear_former_model, note_export
from ssm_pipeline.commands.pseudonyms import KEY_FILE, pseudonyms_of
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.run import Run, load_run

FORMATS = ("npz", "csv", "glb", "ply", "vtp", "statismo", "shapeworks")
ABOUT_FILE = "export.json"


def export_run(
    run_folder: Path, folder: Path | None, formats: Sequence[str], pseudonymise: bool
) -> list[Path]:
    """Write a run's model to `folder` (`export` in the run's own, where None).

    pseudonymise  case ids become case_001 …; the key to them stays in the run's folder.
    Returns the paths written. Raises StudyError for an unknown format, a folder that holds no
    finished run, or one to write to that would mix case ids and pseudonyms.
    """
    wanted = [name.strip() for name in formats]
    if unknown := [name for name in wanted if name not in FORMATS]:
        raise StudyError(
            f"there is no export format {', '.join(unknown)}. Known: {', '.join(FORMATS)}."
        )
    run = load_run(run_folder)
    if folder is None:
        folder = run_folder / ("export-pseudonymised" if pseudonymise else "export")
    _refuse_to_mix(folder, run_folder, pseudonymise)
    names = {case_id: case_id for case_id in run.cases}
    if pseudonymise:
        names = pseudonyms_of(run.cases, run_folder)
    about = folder / ABOUT_FILE
    before = storage.read_json(about) if about.is_file() else {}
    written = _write(run, folder, wanted, names)
    key = next(record.key for record in run.stages if record.stage == "shape_model")
    files = clear_former_model(folder, before, key, written)
    content = _about(run, pseudonymise, names) | {"model_key": key, "files": files}
    storage.write_json(about, content)
    note_export(run_folder, folder)
    return [*written, about]


def _write(run: Run, folder: Path, formats: Sequence[str], names: dict[str, str]) -> list[Path]:
    case_ids = tuple(names[case_id] for case_id in run.cases)
    model = dataclasses.replace(run.model, case_ids=case_ids)
    written: list[Path] = []
    if "npz" in formats:
        model.save(folder / "model.npz")
        written.append(folder / "model.npz")
    if "csv" in formats:
        from ssm_pipeline.export.tables import write_tables

        written += write_tables(model, folder)
    if "glb" in formats:
        from ssm_pipeline.export.glb import write_glb

        write_glb(model, folder / "model.glb")
        written.append(folder / "model.glb")
    if "ply" in formats:
        from ssm_pipeline.export.meshes import write_meshes

        written += write_meshes(model, run.shapes.template, folder / "meshes")
    if "vtp" in formats:
        from ssm_pipeline.export.vtp import write_vtp

        write_vtp(model, folder / "model.vtp")
        written.append(folder / "model.vtp")
    if "statismo" in formats:
        from ssm_pipeline.export.statismo import write_statismo

        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        write_statismo(model, folder / "model.h5", now)
        written.append(folder / "model.h5")
    if "shapeworks" in formats:
        from ssm_pipeline.export.shapeworks import write_project

        shapes = dataclasses.replace(
            run.shapes, case_ids=case_ids, template_id=names[run.template_id]
        )
        frames, meshes = run.frames, [run.mesh(case_id) for case_id in run.cases]
        project = folder / "shapeworks" / "model.swproj"
        written += write_project(shapes, [frames[case] for case in run.cases], meshes, project)
    return written


def _about(run: Run, pseudonymised: bool, names: dict[str, str]) -> dict[str, object]:
    return {
        "study": run.folder.resolve().name,
        "synthetic": run.settings["data"]["source"] == "phantoms",
        "space": "LPS",
        "unit": "mm",
        "pseudonymised": pseudonymised,
        "template": names[run.template_id],
        "cases": len(run.cases),
        "modes": run.model.mode_count,
        "size_removed": run.settings["shape_model"]["with_scale"],
    }


def _refuse_to_mix(folder: Path, run_folder: Path, pseudonymise: bool) -> None:
    """What lies in a folder of pseudonyms is passed on: no file there may name a case."""
    if pseudonymise and (run_folder / KEY_FILE).resolve().is_relative_to(folder.resolve()):
        raise StudyError(
            f"{folder} would hold the key to the pseudonyms, {run_folder / KEY_FILE}, too. Choose "
            "another folder with --to."
        )
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    about = folder / ABOUT_FILE
    before = storage.read_json(about)["pseudonymised"] if about.is_file() else None
    if (pseudonymise and before is not True) or (not pseudonymise and before is True):
        held = {True: "pseudonyms", False: "the cases' own ids", None: "other files"}[before]
        raise StudyError(
            f"{folder} holds {held}, and an export {'with' if pseudonymise else 'without'} "
            "--pseudonymise would mix with them. Choose another folder with --to, or delete it."
        )

"""`workflow export`: write a finished run's model in the formats of other programs."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import clear_former_model, note_export
from ssm_pipeline.commands.import_model import IMPORTED, MEAN
from ssm_pipeline.commands.pseudonyms import KEY_FILE, pseudonyms_of
from ssm_pipeline.export.about import About, write_about
from ssm_pipeline.methods import FULL
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import Run, load_run

FORMATS = ("npz", "csv", "glb", "ply", "vtp", "statismo", "shapeworks")
ABOUT_FILE = "export.json"
# Settings that say how the model was made; none of them holds an id, a path or a name.
_NOT_TOLD = ("_se_mm", "_low_mm", "_high_mm", "_difference_mm")
TOLD_SECTIONS = ("meshing", "adaptation", "groupwise", "shape_model")


def export_run(
    run_folder: Path, folder: Path | None, formats: Sequence[str], pseudonymise: bool
) -> list[Path]:
    """Write a run's model to `folder` (`export` in the run's own, where None).

    Args:
        pseudonymise: Case ids become case_001 …; the key to them stays in the run's folder.

    Returns:
        The paths written.

    Raises:
        StudyError: If a format is unknown, the run is not finished, or the export would mix case
            ids and pseudonyms in one folder.
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
    # In the order of the new names, because the order of the old ones could identify them.
    cases = sorted(run.cases, key=lambda case_id: names[case_id]) if pseudonymise else run.cases
    about = folder / ABOUT_FILE
    before = storage.read_json(about) if about.is_file() else {}
    written = _write(run, folder, wanted, names, cases)
    key = next(record.key for record in run.stages if record.stage == "shape_model")
    files = clear_former_model(folder, before, key, written)
    content = _about(run, pseudonymise, names) | {"model_key": key, "files": files}
    storage.write_json(about, content)
    note_export(run_folder, folder)
    return [*written, about, *write_about(_in_words(run, pseudonymise), folder)]


def _write(
    run: Run,
    folder: Path,
    formats: Sequence[str],
    names: dict[str, str],
    cases: Sequence[str],
) -> list[Path]:
    order = [run.cases.index(case_id) for case_id in cases]
    case_ids = tuple(names[case_id] for case_id in cases)
    model = dataclasses.replace(run.model, scores=run.model.scores[order], case_ids=case_ids)
    written: list[Path] = []
    if "npz" in formats:
        model.save(folder / "model.npz")
        written.append(folder / "model.npz")
    if "csv" in formats:
        from ssm_pipeline.export.measurements import measurements
        from ssm_pipeline.export.tables import write_tables

        written += write_tables(model, folder)
        written.append(folder / "measurements.csv")
        meshes = [run.mesh(case_id) for case_id in cases]
        places = [run.shapes.case_ids.index(case_id) for case_id in cases]
        table = measurements(model, case_ids, meshes, run.shapes.vertices[places])
        storage.write_table(table, written[-1])
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
            run.shapes.subset(order), case_ids=case_ids, template_id=names[run.template_id]
        )
        frames, meshes = run.frames, [run.mesh(case_id) for case_id in cases]
        project = folder / "shapeworks" / "model.swproj"
        written += write_project(shapes, [frames[case] for case in cases], meshes, project)
    return written


def _about(run: Run, pseudonymised: bool, names: dict[str, str]) -> dict[str, object]:
    return {
        "study": run.folder.resolve().name,
        "synthetic": run.settings["data"]["source"] == "phantoms",
        "space": "LPS",
        "unit": "mm",
        "pseudonymised": pseudonymised,
        "template": names[run.template_id],
        "cases": len([case for case in run.cases if case != MEAN]),
        "modes": run.model.mode_count,
        "size_removed": run.settings["shape_model"]["with_scale"],
    }


def _in_words(run: Run, pseudonymised: bool) -> About:
    """Return the facts for README and model card, without names of cases, folders or files."""
    settings = run.settings
    if IMPORTED in {record.note for record in run.stages}:
        return About(
            study=run.folder.resolve().name,
            cases=len([case for case in run.cases if case != MEAN]),
            modes=run.model.mode_count,
            modes_for_90=run.model.modes_for(0.9),
            synthetic=False,
            pseudonymised=pseudonymised,
            size_removed=None,
            settings={"how": "unknown, because the model was imported"},
            metrics=[],
            version=importlib.metadata.version("ssm-pipeline"),
        )
    told = {
        f"{section}.{key}": value
        for section in TOLD_SECTIONS
        for key, value in settings.get(section, {}).items()
        if not isinstance(value, dict | list)
    }
    return About(
        study=run.folder.resolve().name,
        cases=len(run.cases),
        modes=run.model.mode_count,
        modes_for_90=run.model.modes_for(0.9),
        synthetic=settings["data"]["source"] == "phantoms",
        pseudonymised=pseudonymised,
        size_removed=settings["shape_model"]["with_scale"],
        settings=told | {"seed": settings["seed"]} | _mirrored(run),
        metrics=_quality(run),
        version=importlib.metadata.version("ssm-pipeline"),
    )


def _mirrored(run: Run) -> dict[str, object]:
    """Return a note on mirrored cases for studies that unite left and right."""
    mirror = run.settings["data"].get("mirror")
    if not mirror:
        return {}
    return {
        f"mirrored, x → −x, so that the model is of the other side: the {mirror} side": (
            f"{len(run.reflected)} of {len(run.cases)} cases, in ShapeWorks' files, too"
        )
    }


def _quality(run: Run) -> list[str]:
    """Return the full method's scores with all modes, a line each; empty for imported models."""
    table = run.metrics.tables.get("comparison")
    if table is None:
        return []
    row = table[table["method"] == FULL].iloc[0]
    return [
        f"{name.removesuffix('_mm').replace('_', ' ')}: {row[name]:.2f} mm"
        for name in table.columns
        if name.endswith("_mm") and not name.endswith(_NOT_TOLD)
    ]


def _refuse_to_mix(folder: Path, run_folder: Path, pseudonymise: bool) -> None:
    """Raise StudyError if a folder of pseudonyms would also hold case ids."""
    if pseudonymise and (run_folder / KEY_FILE).resolve().is_relative_to(folder.resolve()):
        raise StudyError(
            f"{folder} would contain the key to the pseudonyms, {run_folder / KEY_FILE}. Choose "
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

"""Stage `cohort_check`: which cases do not look like the others. Nothing is dropped."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.cohort_check.copies import advice_on_copies, copies_table
from ssm_pipeline.cohort_check.fingerprint import typical_cases
from ssm_pipeline.cohort_check.judge import judge
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import MESH


def check_meshes(context: Context) -> Outcome:
    """cohort_check.csv; copies.csv; pictures/<case>.png of each striking case beside a typical one.

    The numbers of each case lie in fingerprints/ and fits/: a case added to a study costs its own.
    """
    from ssm_pipeline.cohort_check.check import twins
    from ssm_pipeline.report.check_pictures import picture_beside

    run, case_ids = run_of(context), list(context.case_keys)
    paths = {case_id: run.finished(MESH, case_id) for case_id in case_ids}
    prints = context.map_cases(
        [
            CaseTask(case_id, context.case_key(case_id), partial(fingerprint_case, path))
            for case_id, path in paths.items()
        ],
        folder=context.folder() / "fingerprints",
    )
    numbers = pd.DataFrame([result.row for result in prints])
    typical = typical_cases(case_ids, numbers)
    rests_on = [[context.case_keys[case_id] for case_id in typical], context.seed]
    fits = context.map_cases(
        [
            CaseTask(
                case_id,
                context.case_key(case_id, rests_on),
                partial(fit_case, path, [paths[other] for other in typical], context.seed),
            )
            for case_id, path in paths.items()
        ],
        folder=context.folder() / "fits",
    )
    table = pd.concat([numbers, pd.DataFrame([result.row for result in fits])], axis=1)
    quality = run.mesh_quality.set_index("case_id")
    share = 100 * quality["left_out_ml"] / quality["mask_volume_ml"]
    table.insert(0, "case_id", case_ids)
    table["left_out_percent"] = share.loc[case_ids].to_numpy()
    meshes = {case_id: run.mesh(case_id) for case_id in case_ids}
    pairs = twins(meshes, numbers, context.seed)
    result = judge(table, pairs)
    context.write_table("cohort_check", result.to_dict("records"))
    copies = copies_table(pairs)
    storage.write_table(copies, context.folder() / "copies.csv")
    striking = result[result["remarks"] != ""]
    for path in (context.folder() / "pictures").glob("*.png"):
        path.unlink()
    for case_id, remarks in zip(striking["case_id"], striking["remarks"], strict=True):
        context.terminal.detail(f"case {case_id}: {remarks}")
        beside = next(other for other in typical if other != case_id)
        path = context.folder() / "pictures" / f"{case_id}.png"
        with storage.written_whole(path) as temporary:
            temporary.write_bytes(picture_beside(meshes[case_id], meshes[beside]))
    for line in advice_on_copies(copies):
        context.terminal.detail(f"{line}")
    return Outcome(context.case_keys, note=f"{len(striking)} do not look like the others")


def fingerprint_case(path: Path, folder: Path) -> Row:
    from ssm_pipeline.cohort_check.fingerprint import fingerprint

    return fingerprint(MESH.read(path))


def fit_case(path: Path, typical: Sequence[Path], seed: int, folder: Path) -> Row:
    from ssm_pipeline.cohort_check.rigid_fit import fit_to

    others = [MESH.read(other) for other in typical]
    return fit_to(MESH.read(path), others, seed)

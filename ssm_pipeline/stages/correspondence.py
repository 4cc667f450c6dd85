"""Stage `correspondence`: the template matched to every case."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.methods import PairMethod
from ssm_pipeline.records import CaseError, Correspondence, SpectralBasis, StudyError
from ssm_pipeline.stages.context import Context

if TYPE_CHECKING:  # at run time inside the functions: not every worker needs PyTorch
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.records import CorrespondedShapes, Mesh
    from ssm_pipeline.training.matcher import Matcher

PATHS = "paths"  # folder of the few cases that are interpolated


def match_cases(context: Context) -> Outcome:
    """<case>/correspondence.npz, template → case; paths/<case>/path.npz for a few cases."""
    template_id = _template(context)
    settings = context.settings.adaptation
    trained, own = context.done["training"].key, context.case_keys[template_id]
    rests_on = [trained, own, settings, context.seed]
    matcher, method = _matcher_and_method(context)

    def task(case_id: str, work: Callable[[Pair, Path], Row], also: object = None) -> CaseTask:
        pair = Pair.of(context, template_id, case_id, matcher, method)
        return CaseTask(case_id, context.case_key(case_id, rests_on, also), partial(work, pair))

    results = context.map_cases([task(case_id, match_pair) for case_id in context.case_keys])
    others = [r.case_id for r in results if r.dropped is None and r.case_id != template_id]
    count = min(context.settings.report.paths, len(others))
    chosen = {others[index * len(others) // count] for index in range(count)}
    starts = {result.case_id: result.row.get("start") for result in results}
    places = context.folder() / PATHS
    for place in places.glob("*"):
        if place.name not in chosen:  # of other settings
            shutil.rmtree(place)
    walked = [task(case_id, walk_pair, starts[case_id]) for case_id in sorted(chosen)]
    context.map_cases(walked, folder=places)
    storage.write_json(context.folder() / "template.json", {"template_id": template_id})
    note = f"template {template_id}"
    if matcher is not None:
        counts = Counter(str(result.row["start"]) for result in results if result.dropped is None)
        note += f"; starts: {', '.join(f'{start} {n}' for start, n in counts.most_common())}"
    return context.outcome(results, note=note)


@dataclass(frozen=True)
class Pair:
    """A template and a case, by their files, and how they are matched."""

    template: Path
    case: Path
    matcher: Path | None
    settings: AdaptationSettings
    method: PairMethod
    seed: int

    @staticmethod
    def of(
        context: Context, template_id: str, case_id: str, matcher: Path | None, method: PairMethod
    ) -> Pair:
        return Pair(
            context.case_file("spectral", template_id, "basis.npz"),
            context.case_file("spectral", case_id, "basis.npz"),
            matcher,
            context.settings.adaptation,
            method,
            context.seed,
        )

    def bases(self, name: str) -> tuple[SpectralBasis, SpectralBasis]:
        template, case = (path.with_name(name) for path in (self.template, self.case))
        return storage.load(SpectralBasis, template), storage.load(SpectralBasis, case)

    def networks(self) -> tuple[Matcher | None, CoarsePair | None]:
        """The matcher, and the two surfaces as dense as it was trained on."""
        if self.matcher is None:
            return None, None
        from ssm_pipeline.training.matcher import load_matcher  # PyTorch is needed for it alone

        return load_matcher(self.matcher), self.bases("training_basis.npz")


def match_pair(pair: Pair, folder: Path) -> Row:
    """correspondence.npz."""
    from ssm_pipeline.adaptation.correspond import correspond

    template, case = pair.bases("basis.npz")
    matcher, coarse = pair.networks()
    match = correspond(template, case, matcher, pair.settings, pair.method, coarse, pair.seed)
    storage.save(match, folder / "correspondence.npz")
    return {"case_id": case.case_id, "template_id": template.case_id, "start": match.start}


def walk_pair(pair: Pair, folder: Path) -> Row:
    """path.npz: by the network, unless the match was found from rigid alignment."""
    from ssm_pipeline.adaptation.path import shape_path

    template, case = pair.bases("basis.npz")
    matcher, coarse = pair.networks()
    found = folder.parents[1] / case.case_id / "correspondence.npz"
    if storage.load(Correspondence, found).start == "rigid":
        matcher, coarse = None, None
    path = shape_path(template, case, matcher, pair.settings, coarse, pair.seed)
    storage.save(path, folder / "path.npz")
    return {"case_id": case.case_id, "template_id": template.case_id}


def matched_once(
    context: Context, template: Mesh, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """What this stage found: the template's matches with every case; meshes in their order."""
    from ssm_pipeline.shape_model.correspondence import collect

    matches = matches_in(context.folder("correspondence"), tuple(context.case_keys))
    return collect(template, matches, meshes)


def all_matched(
    context: Context, tasks: Sequence[CaseTask], folder: Path
) -> list[Correspondence]:
    """The correspondences that these tasks write, in their order. Raises CaseError."""
    for result in context.map_cases(tasks, folder=folder):
        if result.dropped is not None:
            raise CaseError(result.case_id, result.dropped)
    return matches_in(folder, [task.case_id for task in tasks])


def matches_in(folder: Path, case_ids: Sequence[str]) -> list[Correspondence]:
    """The correspondences that lie in a folder, one per case."""
    return [
        storage.load(Correspondence, folder / case_id / "correspondence.npz")
        for case_id in case_ids
    ]


def _matcher_and_method(context: Context) -> tuple[Path | None, PairMethod]:
    if context.settings.matching == "none":
        return None, "adaptation only"
    return context.folder("training") / "matcher.pt", "full"


def _template(context: Context) -> str:
    wanted = context.settings.template
    if wanted is None:
        losses = storage.read_table(context.folder("training") / "template_losses.csv")
        return str(losses.loc[losses["mean_loss"].idxmin(), "case_id"])
    if wanted not in context.case_keys:
        raise StudyError(
            f"the template {wanted} is not among the {len(context.case_keys)} cases left: "
            f"{', '.join(context.case_keys)}. Name one of them, or leave template out."
        )
    return wanted

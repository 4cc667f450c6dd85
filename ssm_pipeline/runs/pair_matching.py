"""A template matched to the cases of a run, by files: one pair, or every case up to date."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import PairMethod
from ssm_pipeline.records import CaseError, Correspondence, SpectralBasis
from ssm_pipeline.runs.context import Context

if TYPE_CHECKING:  # at run time inside the functions: not every worker needs PyTorch
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.records import CorrespondedShapes, Mesh
    from ssm_pipeline.training.matcher import Matcher


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


def matched_once(context: Context, template: Mesh, meshes: Sequence[Mesh]) -> CorrespondedShapes:
    """The template matched to every case, before the groupwise rounds; meshes in their order."""
    from ssm_pipeline.shape_model.collected_points import collect

    matches = matches_in(context.folder("correspondence"), tuple(context.case_keys))
    return collect(template, matches, meshes)


def all_matched(context: Context, tasks: Sequence[CaseTask], folder: Path) -> list[Correspondence]:
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

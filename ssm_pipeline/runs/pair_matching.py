"""A template, or a mean shape, matched to the cases of a run: results are kept in files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.keys import key_of_arrays
from ssm_pipeline.engine.per_case import CaseResult, CaseTask, Row
from ssm_pipeline.records import CaseError, Correspondence, SpectralBasis
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import BASIS, CORRESPONDENCE, PATH, TRAINING_BASIS, CaseFile

if TYPE_CHECKING:  # at run time inside the functions: not every worker needs PyTorch
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher


class MapCases(Protocol):
    """Does the tasks that are not finished, each in its own folder inside `folder`."""

    def __call__(self, tasks: Sequence[CaseTask], folder: Path) -> list[CaseResult]: ...


@dataclass(frozen=True)
class Pair:
    """A template and a case, by the files of their spectral bases, and how they are matched."""

    template: Path
    case: Path
    matcher: Path | None
    settings: AdaptationSettings
    method: str
    seed: int

    def bases(self, file: CaseFile[SpectralBasis]) -> tuple[SpectralBasis, SpectralBasis]:
        template, case = (path.with_name(file.name) for path in (self.template, self.case))
        return file.read(template), file.read(case)

    def networks(self) -> tuple[Matcher | None, CoarsePair | None]:
        """The matcher, and the two surfaces as dense as those that it was trained on."""
        if self.matcher is None:
            return None, None
        from ssm_pipeline.training.matcher import load_matcher  # only this needs PyTorch

        return load_matcher(self.matcher), self.bases(TRAINING_BASIS)


@dataclass(frozen=True)
class PairWork:
    """What a stage needs in order to match pairs of its cases and keep the results.

    Attributes:
        basis: Case → the file of its spectral basis.
        case_key: `(case, parts)` → the key of a result that depends on the case and on the parts.
        map_cases: Does the tasks.
        settings: Of the adaptation.
        seed: Of the study.
    """

    basis: Callable[[str], Path]
    case_key: Callable[..., str]
    map_cases: MapCases
    settings: AdaptationSettings
    seed: int

    @staticmethod
    def of(context: Context) -> PairWork:
        return PairWork(
            partial(run_of(context).finished, BASIS),
            context.case_key,
            context.map_cases,
            context.settings.adaptation,
            context.seed,
        )

    def pair(self, template_id: str, case_id: str, matcher: Path | None, method: str) -> Pair:
        template, case = self.basis(template_id), self.basis(case_id)
        return Pair(template, case, matcher, self.settings, method, self.seed)


def match_template(
    work: PairWork,
    template_id: str,
    case_ids: Iterable[str],
    method: str,
    matcher: Path | None,
    matcher_depends_on: Sequence[str],
    folder: Path,
) -> list[Correspondence]:
    """The template matched to each case, kept in `folder`.

    Args:
        matcher_depends_on: What decides the matcher, beside the training of the run.

    Raises:
        CaseError: A case could not be matched.
    """
    depends_on = (method, template_id, work.settings, work.seed, *matcher_depends_on)
    tasks = [
        CaseTask(
            case_id,
            work.case_key(case_id, *depends_on),
            partial(write_match, work.pair(template_id, case_id, matcher, method)),
        )
        for case_id in case_ids
    ]
    return all_matched(work.map_cases, tasks, folder)


def match_mean(
    work: PairWork, template_id: str, folder: Path, number: int, starts: Mapping[str, np.ndarray]
) -> list[Correspondence]:
    """A groupwise round: the mean shape adapted to each case, kept in `folder/round-<number>/`.

    Args:
        starts: Case → `(V, 3)` mm, the mean on the template's faces, placed on the case.

    Raises:
        CaseError: A case could not be matched.
    """
    template, settings, seed = work.basis(template_id), work.settings, work.seed
    tasks = [
        CaseTask(
            case_id,
            work.case_key(case_id, key_of_arrays(start), settings, seed),
            partial(write_match_of_mean, start, template, work.basis(case_id), settings, seed),
        )
        for case_id, start in starts.items()
    ]
    return all_matched(work.map_cases, tasks, round_folder(folder, number))


def write_match(pair: Pair, folder: Path) -> Row:
    """Write correspondence.npz."""
    from ssm_pipeline.adaptation.correspond import correspond_bases

    template, case = pair.bases(BASIS)
    matcher, coarse = pair.networks()
    match = correspond_bases(template, case, matcher, pair.settings, pair.method, coarse, pair.seed)
    storage.save(match, folder / CORRESPONDENCE.name)
    return {
        "case_id": case.case_id,
        "template_id": template.case_id,
        "start": match.start,
        "start_reason": match.start_reason,
    }


def write_match_of_mean(
    start: np.ndarray,
    template_path: Path,
    case_path: Path,
    settings: AdaptationSettings,
    seed: int,
    folder: Path,
) -> Row:
    """Write correspondence.npz of a `(V, 3)` mm shape on the template's faces."""
    from ssm_pipeline.adaptation.correspond import correspond_again

    template, case = BASIS.read(template_path), BASIS.read(case_path)
    match = correspond_again(start, template, case, settings, seed)
    storage.save(match, folder / CORRESPONDENCE.name)
    return {"case_id": case.case_id, "template_id": template.case_id}


def write_path(pair: Pair, folder: Path) -> Row:
    """Write path.npz: by the network, unless the match started from rigid alignment."""
    from ssm_pipeline.adaptation.path import shape_path

    template, case = pair.bases(BASIS)
    matcher, coarse = pair.networks()
    found = folder.parents[1] / case.case_id / CORRESPONDENCE.name
    if CORRESPONDENCE.read(found).start == "rigid":
        matcher, coarse = None, None
    path = shape_path(template, case, matcher, pair.settings, coarse, pair.seed)
    storage.save(path, folder / PATH.name)
    return {"case_id": case.case_id, "template_id": template.case_id}


def all_matched(
    map_cases: MapCases, tasks: Sequence[CaseTask], folder: Path
) -> list[Correspondence]:
    """The correspondences that these tasks write, in their order. Raises CaseError."""
    for result in map_cases(tasks, folder):
        if result.dropped is not None:
            raise CaseError(result.case_id, result.dropped)
    return matches_in(folder, [task.case_id for task in tasks])


def matches_in(folder: Path, case_ids: Iterable[str]) -> list[Correspondence]:
    """The correspondences in a folder, one per case."""
    name, read = CORRESPONDENCE.name, CORRESPONDENCE.read
    return [read(folder / case_id / name) for case_id in case_ids]


def round_folder(folder: Path, number: int) -> Path:
    return folder / f"round-{number}"

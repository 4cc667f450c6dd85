"""The parts of the results page: which study, on what data, with which changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Part:
    """One part of the results.

    kind      "study": a study's run; "phantoms": the phantom benchmark on the reported cohorts;
              "spread": a study's run repeated with other seeds and templates; "training": with few
              and many steps, from built-in and from fresh weights.
    needs     the name that the data's folder is given by (`--data lungs=FOLDER`); None: no data.
    changes   to the study's settings, as `--set` takes them.
    """

    name: str
    kind: Literal["study", "phantoms", "spread", "training"]
    study: str
    needs: str | None = None
    changes: tuple[str, ...] = ()


def _rows(*names: str) -> str:
    return f"comparison.methods={json.dumps(names)}"


_IN_FULL = (
    _rows(
        "S3M",
        "S3M tuned",
        "without groupwise",
        "network start",
        "without adaptation",
        "spectral only",
        "adaptation only",
        "as scanned",
        "nearest point",
        "adaptation only, groupwise",
    ),
    "evaluation.jackknife_samples=24",
)
# Plain registrations, alone and with the same groupwise rounds.
_RIVALS = (
    _rows(
        "affine nearest",
        "affine nearest, groupwise",
        "nricp",
        "nricp, groupwise",
        "cpd",
        "cpd, groupwise",
    ),
    "evaluation.jackknife_samples=24",
)
# Of S3M; published are 30. Its scores over epochs stand beside the lungs' (`benchmark s3m`).
_AS_PUBLISHED, _A_THIRD, _BRIEFLY = (f"comparison.s3m.epochs={n}" for n in (30, 10, 3))
# All that is learned is learned anew five times: the rows that learn most, S3M briefly.
_UNSEEN = (
    _rows("network start", "adaptation only", "adaptation only, groupwise", "S3M"),
    _BRIEFLY,
    "comparison.retrain=true",
    "evaluation.folds=5",
)
_SPREAD = (_rows("network start", "adaptation only"),)
# The rows that rest on the networks alone, no rounds, few draws.
_TRAINING = (
    _rows("network start", "without adaptation"),
    "groupwise.rounds=0",
    "evaluation.points=4000",
    "evaluation.samples=100",
)
# The first cases by name; others chose settings.
_HIPPOCAMPI = ("data.limit=24",)
# Twelve runs, three cohorts as scanned and turned of two families: S3M's rows briefly.
_PHANTOMS = (
    _rows(
        "without groupwise",
        "network start",
        "without adaptation",
        "adaptation only",
        "as scanned",
        "nearest point",
        "nricp",
        "cpd",
        "S3M",
    ),
    "data.cases=12",
    "evaluation.samples=100",
)

PARTS = (
    Part("lungs", "study", "luna16", needs="lungs", changes=(*_IN_FULL, _AS_PUBLISHED)),
    Part("lungs-rivals", "study", "luna16", needs="lungs", changes=_RIVALS),
    Part("lungs-unseen", "study", "luna16", needs="lungs", changes=_UNSEEN),
    Part("lungs-spread", "spread", "luna16", needs="lungs", changes=_SPREAD),
    Part(
        "hippocampi",
        "study",
        "hippocampus",
        needs="hippocampi",
        changes=(*_IN_FULL, _A_THIRD, *_HIPPOCAMPI),
    ),
    Part(
        "hippocampi-rivals",
        "study",
        "hippocampus",
        needs="hippocampi",
        changes=(*_RIVALS, *_HIPPOCAMPI),
    ),
    Part(
        "hippocampi-unseen",
        "study",
        "hippocampus",
        needs="hippocampi",
        changes=(*_UNSEEN, *_HIPPOCAMPI),
    ),
    Part("lungs-training", "training", "luna16", needs="lungs", changes=_TRAINING),
    Part(
        "hippocampi-training",
        "training",
        "hippocampus",
        needs="hippocampi",
        changes=(*_TRAINING, *_HIPPOCAMPI),
    ),
    Part("spleens-training", "training", "spleen", needs="spleens", changes=_TRAINING),
    Part("phantoms-training", "training", "phantoms", changes=(*_TRAINING[:2], "data.cases=12")),
    Part("phantom-lungs", "phantoms", "phantoms", changes=_PHANTOMS),
    Part("phantom-tubes", "phantoms", "phantoms", changes=(*_PHANTOMS, "data.family=tube")),
)

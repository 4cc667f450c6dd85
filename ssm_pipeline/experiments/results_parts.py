"""The parts of the results page: which study, on what data, with which changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal

from ssm_pipeline.methods import METHODS


@dataclass(frozen=True)
class Part:
    """One part of the results.

    Attributes:
        kind: "study", the run of a study; "phantoms", the phantom benchmark on the reported
            cohorts; "spread", a study that is repeated with other seeds and templates; "training",
            a study that is repeated with other training schedules.
        needs: The name of its data folder on the command line (`--data lungs=FOLDER`); None if it
            needs no data.
        changes: To the settings of the study, as `--set` takes them.
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
# The plain registrations, without and with the same groupwise rounds.
_RIVALS = (
    _rows(*(method.id for method in METHODS if method.kind == "registration")),
    "evaluation.jackknife_samples=24",
)
# The published number is 30; `benchmark s3m` measures how the scores depend on it.
_AS_PUBLISHED, _A_THIRD, _BRIEFLY = (f"comparison.s3m.epochs={n}" for n in (30, 10, 3))
# Everything that is learned is learned again five times: the rows that learn most, S3M briefly.
_UNSEEN = (
    _rows("network start", "adaptation only", "adaptation only, groupwise", "S3M"),
    _BRIEFLY,
    "comparison.retrain=true",
    "evaluation.folds=5",
)
_SPREAD = (_rows("network start", "adaptation only"),)
# The rows that depend on the networks only, without rounds and with few draws.
_TRAINING = (
    _rows("network start", "without adaptation"),
    "groupwise.rounds=0",
    "evaluation.points=4000",
    "evaluation.samples=100",
)
# The first cases by name. The settings were chosen on others.
_HIPPOCAMPI = ("data.limit=24",)
# Twelve runs: three cohorts of two families, as scanned and rotated. S3M is trained briefly.
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

"""The parts of the results page: which study, on what data, with which changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal

from ssm_pipeline.methods import FULL, METHODS


@dataclass(frozen=True)
class Part:
    """One part of the results.

    kind      "study": a study's run; "phantoms": the phantom benchmark on the reported cohorts;
              "spread": a study's run repeated with other seeds and templates.
    needs     the name that the data's folder is given by (`--data lungs=FOLDER`); None: no data.
    changes   to the study's settings, as `--set` takes them.
    """

    name: str
    kind: Literal["study", "phantoms", "spread"]
    study: str
    needs: str | None = None
    changes: tuple[str, ...] = ()


# Every row, its interval of specificity, and S3M trained as long as published.
_IN_FULL = (
    f"comparison.methods={json.dumps([name for name in METHODS if name != FULL])}",
    "comparison.s3m.epochs=30",
    "evaluation.jackknife_samples=24",
)
_UNSEEN = (*_IN_FULL, "comparison.retrain=true", "evaluation.folds=5")

PARTS = (
    Part("lungs", "study", "luna16", needs="lungs", changes=_IN_FULL),
    Part("lungs-unseen", "study", "luna16", needs="lungs", changes=_UNSEEN),
    Part("lungs-spread", "spread", "luna16", needs="lungs"),
    Part("hippocampi", "study", "hippocampus", needs="hippocampi", changes=_IN_FULL),
    Part("hippocampi-unseen", "study", "hippocampus", needs="hippocampi", changes=_UNSEEN),
    Part("phantom-lungs", "phantoms", "phantoms", changes=_IN_FULL),
    Part("phantom-tubes", "phantoms", "phantoms", changes=(*_IN_FULL, "data.family=tube")),
)

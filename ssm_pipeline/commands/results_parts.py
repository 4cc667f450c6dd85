"""The parts of the results page: which study, on what data, with which changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


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


_UNSEEN = ("comparison.retrain=true", "evaluation.folds=5")

PARTS = (
    Part("lungs", "study", "luna16", needs="lungs"),
    Part("lungs-unseen", "study", "luna16", needs="lungs", changes=_UNSEEN),
    Part("lungs-spread", "spread", "luna16", needs="lungs"),
    Part("hippocampi", "study", "hippocampus", needs="hippocampi"),
    Part("hippocampi-unseen", "study", "hippocampus", needs="hippocampi", changes=_UNSEEN),
    Part("phantom-lungs", "phantoms", "phantoms"),
    Part("phantom-tubes", "phantoms", "phantoms", changes=("data.family=tube",)),
)

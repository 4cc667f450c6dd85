"""The methods that can be compared, by the names that settings, tables, figures and pages use.

Light on purpose: a settings file is read, and a report drawn, without the networks' library.
"""

from __future__ import annotations

from typing import Literal, get_args

PairMethod = Literal[
    "full",
    "without adaptation",
    "pose",
    "projected features",
    "features",
    "spectral only",
    "adaptation only",
    "nearest point",
]
"""Ways to match one template to one case (`adaptation.correspond`)."""

Method = Literal[
    "full",
    "without groupwise",
    "without adaptation",
    "pose",
    "projected features",
    "features",
    "spectral only",
    "adaptation only",
    "adaptation only, groupwise",
    "nearest point",
    "S3M",
    "S3M tuned",
]
"""Rows of a study's comparison (`stages.compared_methods`)."""

FULL: Literal["full"] = "full"
TRUTH = "true correspondence"  # of a synthetic cohort: no method can do better
RETRAINED = "full, retrained folds"  # the matcher has not seen the held-out case
METHODS: tuple[Method, ...] = get_args(Method)
# Rows whose matching looks at one case at a time: no training, no cohort's mean.
ONE_CASE_AT_A_TIME: tuple[str, ...] = ("adaptation only", "nearest point", TRUTH)
# Rows that use no network: nothing is trained for them.
WITHOUT_NETWORK: tuple[str, ...] = (
    "adaptation only",
    "adaptation only, groupwise",
    "nearest point",
)

"""The methods that can be compared, by the names that settings, tables, figures and pages use.

Light on purpose: a settings file is read, and a report drawn, without the networks' library.
"""

from __future__ import annotations

from typing import Literal, get_args

PairMethod = Literal[
    "full",
    "network start",
    "without adaptation",
    "pose",
    "projected features",
    "features",
    "spectral only",
    "adaptation only",
    "as scanned",
    "nearest point",
]
"""Ways to match one template to one case (`adaptation.correspond`)."""

Registration = Literal["affine nearest", "nricp", "cpd"]
"""Plain registrations of one template to one case (`baselines.register`)."""

Method = Literal[
    "full",
    "without groupwise",
    "network start",
    "without adaptation",
    "pose",
    "projected features",
    "features",
    "spectral only",
    "adaptation only",
    "adaptation only, groupwise",
    "as scanned",
    "nearest point",
    "affine nearest",
    "affine nearest, groupwise",
    "nricp",
    "nricp, groupwise",
    "cpd",
    "cpd, groupwise",
    "S3M",
    "S3M tuned",
]
"""Rows of a study's comparison (`stages.compared_methods`)."""

FULL: Literal["full"] = "full"
TRUTH = "true correspondence"  # of a synthetic cohort: no method can do better
REGISTRATIONS: tuple[Registration, ...] = get_args(Registration)
# Rows whose matching looks at one case at a time: no training, no cohort's mean.
ONE_CASE_AT_A_TIME: tuple[str, ...] = (
    "adaptation only",
    "as scanned",
    "nearest point",
    *REGISTRATIONS,
    TRUTH,
)
# Rows that use no network: nothing is trained for them.
WITHOUT_NETWORK: tuple[str, ...] = (
    "adaptation only",
    "adaptation only, groupwise",
    "as scanned",
    "nearest point",
    *REGISTRATIONS,
    *(f"{registration}, groupwise" for registration in REGISTRATIONS),
)


def registration_of(method: str) -> Registration | None:
    """The plain registration that a row rests on, if it rests on one.

    >>> registration_of("nricp, groupwise")
    'nricp'
    """
    alone = method.removesuffix(", groupwise")
    return next((name for name in REGISTRATIONS if name == alone), None)

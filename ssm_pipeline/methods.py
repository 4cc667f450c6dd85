"""The methods that can be compared: one entry per method, read by settings, tables and pages.

A new method is one entry in `METHODS`. Where no existing kind fits it, it also needs one function
in `comparison.producers`. This module imports nothing heavy: settings are read and reports are
drawn without PyTorch.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Kind = Literal["pair", "registration", "S3M", "truth"]
Start = Literal[
    "best", "network", "rigid", "as scanned", "feature map", "projected features", "features"
]
Network = Literal["study", "spectral loss", "own"]


@dataclass(frozen=True)
class Method:
    """One method, which is one row of a comparison.

    Attributes:
        id: Its name in settings, tables and figures.
        label: What it does, in a few words.
        kind: Which function of `comparison.producers` makes its shapes.
            `pair` matches a template to each case (`adaptation.correspond`), `registration` does
            so by a plain registration (`baselines.register`), `S3M` is the baseline of that name,
            and `truth` is the known correspondence of a synthetic cohort.
        start: The shape that is moved onto each case. `best` keeps the best of several poses. The
            last three are maps of the network's features instead of a pose.
        network: The weights that it reads: the study's, weights that are trained for it on the
            spectral loss only, or its own. None if it uses no network.
        adapts: Whether the start is then adapted to the case.
        groupwise: Whether the groupwise rounds of the study follow.
        base: The method that matches the template to each case. Methods with the same base share
            these results, so they are computed once. Its own `id` if it is not given.
    """

    id: str
    label: str
    kind: Kind
    start: Start = "rigid"
    network: Network | None = None
    adapts: bool = False
    groupwise: bool = False
    base: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", self.base or self.id)

    @property
    def uses_network(self) -> bool:
        return self.network is not None

    @property
    def learns(self) -> bool:
        """Whether other cases than the matched one decide the result."""
        return self.uses_network or self.groupwise

    @property
    def folder(self) -> str:
        """The name of its folder in a run."""
        return folder_name(self.id)


FULL: Literal["full"] = "full"
TRUTH = "true correspondence"

METHODS: tuple[Method, ...] = (
    Method(
        FULL,
        "network, adaptation and groupwise rounds",
        "pair",
        start="best",
        network="study",
        adapts=True,
        groupwise=True,
    ),
    Method(
        "without groupwise",
        "network and adaptation",
        "pair",
        start="best",
        network="study",
        adapts=True,
        base=FULL,
    ),
    Method(
        "network start",
        "adaptation from the network's pose only, as in the paper",
        "pair",
        start="network",
        network="study",
        adapts=True,
    ),
    Method(
        "without adaptation",
        "the map of the jointly trained features, a row of the paper",
        "pair",
        start="feature map",
        network="study",
    ),
    Method("pose", "the network's pose X(1)", "pair", start="network", network="study"),
    Method(
        "projected features",
        "nearest features, projected onto the eigenbasis",
        "pair",
        start="projected features",
        network="study",
    ),
    Method("features", "nearest features", "pair", start="features", network="study"),
    Method(
        "spectral only",
        "the map of features that are trained on the spectral loss only",
        "pair",
        start="feature map",
        network="spectral loss",
    ),
    Method("adaptation only", "rigid alignment and adaptation", "pair", adapts=True),
    Method(
        "adaptation only, groupwise",
        "rigid alignment, adaptation and groupwise rounds",
        "pair",
        adapts=True,
        groupwise=True,
        base="adaptation only",
    ),
    Method(
        "as scanned",
        "adaptation from the scanner's pose, without alignment",
        "pair",
        start="as scanned",
        adapts=True,
    ),
    Method("nearest point", "rigid alignment and the nearest points", "pair"),
    Method("affine nearest", "affine alignment and the nearest points", "registration"),
    Method(
        "affine nearest, groupwise",
        "affine alignment, the nearest points and groupwise rounds",
        "registration",
        groupwise=True,
        base="affine nearest",
    ),
    Method("nricp", "non-rigid iterative closest points", "registration"),
    Method(
        "nricp, groupwise",
        "non-rigid iterative closest points and groupwise rounds",
        "registration",
        groupwise=True,
        base="nricp",
    ),
    Method("cpd", "coherent point drift", "registration"),
    Method(
        "cpd, groupwise",
        "coherent point drift and groupwise rounds",
        "registration",
        groupwise=True,
        base="cpd",
    ),
    Method("S3M", "the baseline S3M with its published settings", "S3M", network="own"),
    Method(
        "S3M tuned",
        "the baseline S3M with its filter in proportion to the organ",
        "S3M",
        network="own",
        base="S3M",
    ),
    Method(
        TRUTH,
        "the known correspondence of a synthetic cohort, which no method can exceed",
        "truth",
        start="as scanned",
    ),
)


def find_method(name: str) -> Method | None:
    """The method of this name; None for a name that is not in `METHODS`.

    >>> find_method("nricp, groupwise").base
    'nricp'
    """
    return next((method for method in METHODS if method.id == name), None)


def method_named(name: str, among: Sequence[str] | None = None) -> Method:
    """The method of this name.

    Args:
        name: Its `id`.
        among: The names that are allowed; None allows every method.

    Raises:
        ValueError: No allowed method has this name. The message lists those that are allowed.
    """
    allowed = [method.id for method in METHODS] if among is None else among
    found = find_method(name)
    if found is None or name not in allowed:
        near = difflib.get_close_matches(name, allowed, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise ValueError(f"there is no method {name!r}: {', '.join(allowed)}.{hint}")
    return found


def comparable_methods() -> tuple[str, ...]:
    """The methods that a study can list in `comparison.methods`."""
    return tuple(method.id for method in METHODS if method.kind != "truth")


def base_methods(kind: Kind) -> tuple[str, ...]:
    """The methods of a kind that match one template to one case, and do nothing else.

    >>> base_methods("registration")
    ('affine nearest', 'nricp', 'cpd')
    """
    return tuple(dict.fromkeys(method.base for method in METHODS if method.kind == kind))


def learns(name: str) -> bool:
    """Whether other cases decide a method's matching; true for a name that is not in `METHODS`."""
    found = find_method(name)
    return found is None or found.learns


def folder_name(name: str) -> str:
    """A method's name without the characters that are awkward in paths.

    >>> folder_name("nricp, groupwise")
    'nricp-groupwise'
    """
    return name.replace(",", "").replace(" ", "-")

"""The table of methods: values, differences from the full method with intervals, and traits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ssm_pipeline.methods import FULL, find_method
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.tables import p_text, text

ALPHA = 0.05
Column = tuple[str, str, str, str]  # prefix of its columns, heading, subtitle, unit
# Lower is better for all columns except the variance.
_FIRST: tuple[Column, ...] = (
    ("generalisation_surface", "Generalisation", "surface distance", "mm"),
    ("unseen_generalisation_surface", "Generalisation, case unseen", "surface distance", "mm"),
    ("specificity_surface", "Specificity", "surface distance", "mm"),
)
_FURTHER: tuple[Column, ...] = (
    ("generalisation_chamfer", "Generalisation", "Chamfer", "mm"),
    ("specificity_chamfer", "Specificity", "Chamfer", "mm"),
    ("generalisation_hd95", "Generalisation", "95th percentile", "mm"),
    ("surface_fit", "New case", "fitted by the model", "mm"),
    ("seen_specificity_surface", "Specificity", "of as few cases, seen", "mm"),
    ("unseen_specificity_surface", "Specificity", "of as few cases, unseen", "mm"),
    ("labels_border", "Label borders", "displaced", "mm"),
    ("variance_kept", "Variance", "of the truth's", "percent"),
    ("variance", "Variance", "of its own", "percent"),
)
_MOST_WITH_P = 2  # with more intervals than this, p is shown on hover instead of in its own column
_UNIT_TEXT = {"mm": "mm", "percent": "%"}


@dataclass(frozen=True)
class Difference:
    """A method minus the full one on the same cases: the value and its 95 % interval low … high.

    The verdict is better or worse if the interval does not contain 0 and p, if any, is below 0.05.

    Attributes:
        p: With Holm's correction for the number of methods; NaN if it was not computed.
        at: Position on the axis that all rows share, in percent; 50 is no difference. at_low and
            at_high are the positions of the interval's ends.
    """

    low: float
    value: float
    high: float
    p: float
    at_low: float
    at: float
    at_high: float

    @property
    def verdict(self) -> str:
        if pd.notna(self.p) and self.p >= ALPHA:
            return "alike"
        return "better" if self.high < 0 else "worse" if self.low > 0 else "alike"

    @property
    def shown(self) -> str:
        """The value with its sign, unless it is rounded to zero."""
        return f"{'+' if float(f'{self.value:.2f}') > 0 else ''}{text(self.value)}"

    @property
    def is_off(self) -> bool:
        """Whether the value lies beyond the axis."""
        return not 0 < self.at < 100

    @property
    def p_shown(self) -> str:
        return p_text(self.p)

    @property
    def label(self) -> str:
        interval = f"{text(self.low)} to {text(self.high)}"
        p = f", p {p_text(self.p)}" if pd.notna(self.p) else ""
        return f"{text(self.value)} ({interval}{p}): {self.verdict}"


@dataclass(frozen=True)
class Measure:
    """One column; the subtitle holds the unit, and axis is half the width of the interval plot."""

    title: str
    subtitle: str
    has_difference: bool  # whether the difference is drawn with its interval
    axis: str


@dataclass(frozen=True)
class MethodRow:
    """One row. Each cell has a value and a difference.

    uses_network and saw_case are None if they are not known, and for the floor of the distance.
    """

    method: str
    kind: str  # "method", "full" or "floor"
    uses_network: bool | None
    saw_case: bool | None
    cells: tuple[tuple[str, Difference | None], ...]

    @property
    def label(self) -> str:
        """What the method does; empty for a name that is not in `methods.METHODS`."""
        method = find_method(self.method)
        return "" if method is None else method.label


@dataclass(frozen=True)
class MethodTable:
    measures: tuple[Measure, ...]
    rows: tuple[MethodRow, ...]
    says_network: bool
    says_seen: bool

    @property
    def has_differences(self) -> bool:
        return any(difference is not None for row in self.rows for _, difference in row.cells)

    @property
    def has_p(self) -> bool:
        differences = [difference for row in self.rows for _, difference in row.cells]
        return any(d is not None and pd.notna(d.p) for d in differences)

    @property
    def shows_p(self) -> bool:
        return self.has_p and sum(m.has_difference for m in self.measures) <= _MOST_WITH_P


def method_tables(
    metrics: Mapping[str, pd.DataFrame], has_network: bool = True
) -> tuple[MethodTable | None, MethodTable | None]:
    """The table `comparison` in two parts, with the best generalisation first.

    The first part has the main measures with intervals, and the second part the others. A part
    without measures is None. Borders of labels come from the table `labels_mean`. If the scores
    hold the floor of the Chamfer distance, it is the last row.

    Args:
        metrics: The tables. In `comparison` only the column `method` is required.
            `<prefix>_<unit>` is a value and `_se_` its standard error. `_difference_`, `_low_` and
            `_high_` are the paired difference from the full method and its interval, and
            `<prefix>_p` is its adjusted p.
        has_network: Whether the study uses a network.
    """
    table = metrics.get("comparison")
    if table is None or table.empty:
        return None, None
    table = _with_labels(table, metrics.get("labels_mean"))
    first, further = ([m for m in some if _column(m) in table] for some in (_FIRST, _FURTHER))
    if first:
        table = table.sort_values(_column(first[0]), kind="stable")
    floor = _floor(metrics, further)
    traits = method_traits(metrics, has_network)
    at_a_glance = _method_table(table, first, traits)
    if not further:
        return at_a_glance, None
    more = _method_table(table, further, traits)
    return at_a_glance, more if floor is None else replace(more, rows=(*more.rows, floor))


def _method_table(
    table: pd.DataFrame,
    measures: Sequence[Column],
    traits: Mapping[str, tuple[bool | None, bool | None]],
) -> MethodTable:
    drawn = {m for m in measures if m in _FIRST and f"{m[0]}_difference_{m[3]}" in table}
    ranges = {m: _range(table, m[0], m[3]) for m in measures}
    rows = [
        MethodRow(
            str(row["method"]),
            "full" if row["method"] == FULL else "method",
            *traits[str(row["method"])],
            tuple(
                (
                    _value(row, m[0], m[3]),
                    None if row["method"] == FULL else _difference(row, m[0], m[3], ranges[m]),
                )
                for m in measures
            ),
        )
        for _, row in table.iterrows()
    ]
    return MethodTable(
        tuple(
            Measure(m[1], f"{m[2]}, {_UNIT_TEXT[m[3]]}", m in drawn, f"{ranges[m]:g}")
            for m in measures
        ),
        tuple(rows),
        any(row.uses_network is not None for row in rows),
        any(row.saw_case is not None for row in rows),
    )


def _column(measure: Column) -> str:
    return f"{measure[0]}_{measure[3]}"


def _with_labels(comparison: pd.DataFrame, labels: pd.DataFrame | None) -> pd.DataFrame:
    """The comparison with the distance by which transferred labels miss their borders."""
    if labels is None or "border_mm" not in labels:
        return comparison
    names = {
        "border_mm": "labels_border_mm",
        "border_difference_mm": "labels_border_difference_mm",
        "border_difference_low_mm": "labels_border_low_mm",
        "border_difference_high_mm": "labels_border_high_mm",
        "border_difference_p": "labels_border_p",
    }
    own = labels.set_index("method").rename(columns=names)
    kept = [name for name in names.values() if name in own]
    return comparison.join(own[kept], on="method")


def without_shown(comparison: pd.DataFrame) -> pd.DataFrame:
    """The columns of a comparison that the two tables of methods do not show; may be empty."""
    prefixes = "|".join(prefix for prefix, *_ in (*_FIRST, *_FURTHER))
    shown = re.compile(rf"({prefixes})_((se|difference|low|high)_)?(mm|percent|p)|uses_network")
    rest = [name for name in comparison if not shown.fullmatch(str(name))]
    return (
        comparison[rest] if set(rest) - {"method", "modes", "cases", "points"} else pd.DataFrame()
    )


def method_traits(
    metrics: Mapping[str, pd.DataFrame], has_network: bool = True
) -> dict[str, tuple[bool | None, bool | None]]:
    """Method → (uses a network, has seen the case that it is scored on); None if not known.

    A column of the tables decides. Without one, `methods.METHODS` says whether the method uses a
    network, and `has_network` whether the study has one. S3M has its own.
    """
    traits: dict[str, tuple[bool | None, bool | None]] = {}
    for table in metrics.values():
        if "method" not in table:
            continue
        for method, rows in table.groupby("method", sort=False):
            network, saw = traits.get(str(method), (None, None))
            if network is None:
                network = _network_by_name(str(method), has_network)
            network = _flag(rows, "uses_network", network)
            traits[str(method)] = network, _flag(rows, "matching_saw_case", saw)
    return traits


def _network_by_name(name: str, has_network: bool) -> bool | None:
    method = find_method(name)
    if method is None or method.kind == "truth":
        return None
    return method.network == "own" or (has_network and method.uses_network)


def _flag(rows: pd.DataFrame, column: str, otherwise: bool | None) -> bool | None:
    if column not in rows or rows[column].isna().any():
        return otherwise
    return bool(rows[column].astype(bool).any())


def _value(row: pd.Series, prefix: str, unit: str) -> str:
    decimals = 2 if unit == "mm" else 1
    value, error = row[f"{prefix}_{unit}"], row.get(f"{prefix}_se_{unit}")
    shown = text(value, decimals)
    return shown if error is None or pd.isna(error) else f"{shown} ± {text(error, decimals)}"


def _difference(row: pd.Series, prefix: str, unit: str, reach: float) -> Difference | None:
    low, value, high = (
        float(row.get(f"{prefix}_{part}_{unit}", float("nan")))
        for part in ("low", "difference", "high")
    )
    if any(map(pd.isna, (low, value, high))):
        return None
    p = row.get(f"{prefix}_p")
    at = [50 + 50 * min(max(x / reach, -1), 1) for x in (low, value, high)]
    return Difference(low, value, high, float("nan") if p is None else float(p), *at)


def _range(table: pd.DataFrame, prefix: str, unit: str) -> float:
    """Half the width of the interval plot: most ends lie inside it, the others at its edge."""
    parts = [
        f"{prefix}_{part}_{unit}" for part in ("low", "high") if f"{prefix}_{part}_{unit}" in table
    ]
    if not parts:
        return 1.0
    ends = table[parts].abs().max(axis=1).dropna()
    # One very different method would compress all the others onto the zero line.
    reach = min(ends.max(), 2.5 * ends[ends > 0].median()) if (ends > 0).any() else 1.0
    return round_up(float(reach), FINE)


def _floor(metrics: Mapping[str, pd.DataFrame], measures: Sequence[Column]) -> MethodRow | None:
    """The Chamfer distance between two samplings of one surface: no method can be below it."""
    values: dict[str, str] = {}
    for name in ("generalisation", "specificity"):
        table = metrics.get(name)
        if table is not None and "chamfer_floor_mm" in table:
            values[f"{name}_chamfer"] = text(table["chamfer_floor_mm"].mean())
    if not any(prefix in values for prefix, *_ in measures):
        return None
    cells = tuple((values.get(prefix, ""), None) for prefix, *_ in measures)
    return MethodRow("floor of the distance", "floor", None, None, cells)

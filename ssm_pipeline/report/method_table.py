"""The table of methods: values, differences from the full method with intervals, and traits."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ssm_pipeline.methods import FULL, find_method
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.tables import p_text, saved_value, text

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
    ("seen_specificity_surface", "Specificity", "model of fewer cases, seen", "mm"),
    ("unseen_specificity_surface", "Specificity", "model of fewer cases, unseen", "mm"),
    ("labels_border", "Label borders", "displaced", "mm"),
    ("variance_kept", "Variance", "relative to the truth", "percent"),
    ("variance", "Variance", "explained", "percent"),
)
_MOST_WITH_P = 2  # with more intervals than this, p is shown on hover instead of in its own column
_UNIT_TEXT = {"mm": "mm", "percent": "%"}


@dataclass(frozen=True)
class Difference:
    """A method minus the full one over the same cases.

    Attributes:
        low: Lower end of the 95 % interval.
        value: The mean difference.
        high: Upper end of the 95 % interval.
        p: Adjusted for the number of methods (Holm); NaN if it was not computed.
        at_low: Position of `low` on the axis that all rows share, in percent; 50 is no difference.
        at: Position of `value`.
        at_high: Position of `high`.
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
        """Better or worse if the interval excludes 0 and p, if there is one, is below 0.05."""
        if pd.notna(self.p) and self.p >= ALPHA:
            return "alike"
        return "better" if self.high < 0 else "worse" if self.low > 0 else "alike"

    @property
    def shown(self) -> str:
        """The difference with its sign; a clear one has digits enough not to read as zero."""
        decimals = 2 if self.verdict == "alike" else _decimals(self.value)
        shown = text(self.value, decimals)
        return f"+{shown}" if float(f"{self.value:.{decimals}f}") > 0 else shown

    @property
    def is_off(self) -> bool:
        """Whether the value lies beyond the axis."""
        return not 0 < self.at < 100

    @property
    def p_shown(self) -> str:
        return p_text(self.p)

    @property
    def label(self) -> str:
        ends = (self.low, self.value, self.high)
        decimals = 2 if self.verdict == "alike" else max(map(_decimals, ends))
        low, value, high = (text(end, decimals) for end in ends)
        p = f", p {p_text(self.p)}" if pd.notna(self.p) else ""
        return f"{value} ({low} to {high}{p}): {self.verdict}"


def _decimals(value: float) -> int:
    """Two, and more where a small value would read as zero.

    >>> _decimals(0.12), _decimals(-0.0048), _decimals(0.0)
    (2, 4, 2)
    """
    return 2 if value == 0 or abs(value) >= 0.01 else min(1 - math.floor(math.log10(abs(value))), 6)


@dataclass(frozen=True)
class Score:
    """A method's value of one measure, with its standard error (NaN: unknown) and difference.

    `missing` is true where the other rows have a difference and this one has none.
    """

    value: float
    error: float
    decimals: int
    difference: Difference | None = None
    missing: bool = False

    @property
    def shown(self) -> str:
        shown = text(self.value, self.decimals)
        return shown if math.isnan(self.error) else f"{shown} ± {text(self.error, self.decimals)}"

    @property
    def saved(self) -> tuple[str, ...]:
        """Value and standard error, as the CSV holds them."""
        return saved_value(self.value), saved_value(self.error)

    @property
    def saved_difference(self) -> tuple[str, ...]:
        """Difference, the ends of its interval, and p, as the CSV holds them."""
        d = self.difference
        return ("",) * 4 if d is None else tuple(map(saved_value, (d.value, d.low, d.high, d.p)))


@dataclass(frozen=True)
class Measure:
    """One measure of the table.

    Attributes:
        title: Shown above.
        subtitle: The kind of distance, with its unit.
        has_difference: Whether the difference from the full method is drawn with its interval.
        axis: Half the width of the interval plot.
    """

    title: str
    subtitle: str
    has_difference: bool
    axis: str

    @property
    def saved(self) -> tuple[str, ...]:
        """Names of the CSV's columns of value and standard error."""
        name = f"{self.title}, {self.subtitle}"
        return name, f"{name}, standard error"

    @property
    def saved_difference(self) -> tuple[str, ...]:
        """Names of the CSV's columns of the difference."""
        name = f"{self.title}: difference from full"
        return name, f"{name}, low", f"{name}, high", f"{self.title}: p (Holm)"


@dataclass(frozen=True)
class MethodRow:
    """One method: `uses_network` and `saw_case` are None if unknown, and for a floor."""

    method: str
    kind: str  # "method", "full" or "floor"
    uses_network: bool | None
    saw_case: bool | None
    cells: tuple[Score, ...]

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
        return any(cell.difference is not None for row in self.rows for cell in row.cells)

    @property
    def has_missing(self) -> bool:
        """Whether a row lacks a difference that other rows have."""
        return any(cell.missing for row in self.rows for cell in row.cells)

    @property
    def lacks_specificity(self) -> bool:
        """Whether specificity has no differences beside other measures that have them."""
        alone = [m for m in self.measures if not m.has_difference]
        return len(alone) < len(self.measures) and any(m.title == "Specificity" for m in alone)

    @property
    def has_p(self) -> bool:
        differences = [cell.difference for row in self.rows for cell in row.cells]
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
    drawn = {m for m in measures if m in _FIRST and _has_differences(table, m)}
    ranges = {m: _range(table, m[0], m[3]) for m in measures}
    rows = [
        MethodRow(
            str(row["method"]),
            "full" if row["method"] == FULL else "method",
            *traits[str(row["method"])],
            tuple(
                _score(row, m, ranges[m], needs_difference=m in drawn and row["method"] != FULL)
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


def _has_differences(table: pd.DataFrame, measure: Column) -> bool:
    """Whether any method but the full one has a difference from it."""
    column = f"{measure[0]}_difference_{measure[3]}"
    return column in table and bool(table.loc[table["method"] != FULL, column].notna().any())


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


def _score(row: pd.Series, measure: Column, reach: float, needs_difference: bool) -> Score:
    prefix, unit = measure[0], measure[3]
    value, error = row[f"{prefix}_{unit}"], row.get(f"{prefix}_se_{unit}")
    difference = None if row["method"] == FULL else _difference(row, prefix, unit, reach)
    return Score(
        value=float("nan") if pd.isna(value) else float(value),
        error=float("nan") if error is None or pd.isna(error) else float(error),
        decimals=2 if unit == "mm" else 1,
        difference=difference,
        missing=needs_difference and difference is None,
    )


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
    values: dict[str, float] = {}
    for name in ("generalisation", "specificity"):
        table = metrics.get(name)
        if table is not None and "chamfer_floor_mm" in table:
            values[f"{name}_chamfer"] = float(table["chamfer_floor_mm"].mean())
    if not any(prefix in values for prefix, *_ in measures):
        return None
    nan = float("nan")
    cells = tuple(Score(values.get(prefix, nan), nan, 2) for prefix, *_ in measures)
    return MethodRow("lower bound of the distance", "floor", None, None, cells)

"""A table of covariates, checked against the cases, and the design that a formula makes of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ssm_pipeline.counting import counted
from ssm_pipeline.data_prep.formats.tables import typed
from ssm_pipeline.records import StudyError

ID_COLUMNS = ("case_id", "participant_id")  # ours; BIDS's
FEWEST_IN_GROUP = 3
CASES_PER_COLUMN = 5  # fewer, and the coefficients are noise


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a design: its place, the term of the formula that it belongs to, a name for
    people, and the unit one step of the result is in: a group against the other, or 1 SD more."""

    place: int
    term: str
    name: str
    step: float


@dataclass(frozen=True, eq=False)
class Design:
    """matrix (N, P), the first column all ones; columns: the others; covariates: a row per case,
    case_id first, as the formula uses them."""

    formula: str
    matrix: np.ndarray
    columns: tuple[Column, ...]
    covariates: pd.DataFrame

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(column.term for column in self.columns))

    def places(self, term: str) -> list[int]:
        """The columns of a term."""
        return [column.place for column in self.columns if column.term == term]


def case_ids_of(table: pd.DataFrame) -> pd.Series:
    """The ids in a table of covariates, as text.

    Raises:
        StudyError: For a table without them.
    """
    found = [name for name in ID_COLUMNS if name in table]
    if not found:
        raise StudyError(
            f"the table of covariates has no column {' or '.join(ID_COLUMNS)}; its columns are "
            f"{', '.join(map(str, table.columns))}. Name the column of the cases' ids so."
        )
    return table[found[0]].astype(str).str.strip()


def matched_to_cases(
    table: pd.DataFrame, case_ids: Sequence[str], left_out: Collection[str] = ()
) -> pd.DataFrame:
    """The table's rows in the order of the cases, ids as text in a first column case_id.

    Args:
        table: With a column of ids, `case_id` or `participant_id`.
        case_ids: The cases of the model.
        left_out: Cases that the run left out. Their rows are not used.

    Raises:
        StudyError: The table has no ids, or ids that are unknown, missing or doubled. No other
            row is left out, and no case.
    """
    ids = case_ids_of(table)
    doubled = sorted(set(ids[ids.duplicated()]))
    unknown = sorted(set(ids) - set(case_ids) - set(left_out))
    missing = [case_id for case_id in case_ids if case_id not in set(ids)]
    problems = [
        f"{len(names)} {what}: {', '.join(names[:5])}{' …' if len(names) > 5 else ''}"
        for names, what in (
            (doubled, "in the table more than once"),
            (unknown, "in the table but not in the model"),
            (missing, "in the model but not in the table"),
        )
        if names
    ]
    if problems:
        advice = ["correct the ids"]
        advice += ["delete the rows of other cases"] if unknown else []
        advice += ["add the missing rows, or exclude these cases (data.exclude) and run the study"]
        raise StudyError(
            f"the table of covariates does not fit the model's {len(case_ids)} cases. "
            + "; ".join(problems)
            + f". One row per case is needed: {'; '.join(advice if missing else advice[:-1])}."
        )
    rows = table.assign(case_id=ids).set_index("case_id").loc[list(case_ids)].reset_index()
    return rows[["case_id", *[n for n in rows.columns if n not in ("case_id", *ID_COLUMNS)]]]


def design_of(formula: str, covariates: pd.DataFrame) -> Design:
    """The design of a formula such as "~ sex + age" (Wilkinson's notation).

    Args:
        covariates: As `matched_to_cases` returns them.

    Raises:
        StudyError: For a formula that can't be read, or names no column; for a covariate that is
            constant, has empty cells or a group of fewer than three; for columns that say the same;
            and for more columns than the cases carry, with the number that they do.
    """
    import formulaic
    from formulaic.errors import FormulaicError

    text = formula.strip()
    right = text if text.startswith("~") else f"~ {text}"
    known = [str(name) for name in covariates.columns if name != "case_id"]
    try:
        variables = variables_of(formula)
    except StudyError as error:
        raise StudyError(f"{error} The table has {', '.join(known)}.") from error
    if unknown := [name for name in variables if name not in known]:
        raise StudyError(
            f"the formula {formula!r} names {', '.join(unknown)}, and the table has "
            f"{', '.join(known)}."
        )
    if not variables:
        raise StudyError(f"the formula {formula!r} names no covariate; the table has {known}.")
    used = typed(covariates[["case_id", *variables]], _columns_of_text(covariates, variables))
    _check_values(used, variables)
    try:
        made = formulaic.model_matrix(right, used, na_action="raise")
    except (FormulaicError, ValueError, TypeError, KeyError) as error:
        raise StudyError(f"the formula {formula!r} can't be used: {error}.") from error
    matrix = np.asarray(made, dtype=np.float64)
    names = [str(name) for name in made.columns]
    if "Intercept" not in names:
        raise StudyError(f"the formula {formula!r} takes the intercept out; leave it in.")
    order = [names.index("Intercept"), *[i for i, n in enumerate(names) if n != "Intercept"]]
    matrix, names = matrix[:, order], [names[i] for i in order]
    _check_size(matrix, names, len(used))
    terms = {
        str(made.columns[place]): str(term)
        for term, places in made.model_spec.term_indices.items()
        for place in places
    }
    bases = {}
    for factor, state in made.model_spec.factor_contrasts.items():
        for name in formulaic.Formula(f"~ {factor}").required_variables:
            _check_groups(str(name), used[str(name)])
        coded = state.contrasts.get_coding_column_names(state.levels, reduced_rank=True)
        bases[str(factor)] = str(next(level for level in state.levels if level not in coded))
    columns = [
        _column(place, names[place], terms[names[place]], matrix[:, place], bases)
        for place in range(1, len(names))
    ]
    return Design(text, matrix, tuple(columns), used)


def variables_of(formula: str) -> list[str]:
    """Names of the columns that a formula uses, sorted. Raises StudyError.

    >>> variables_of("~ sex + C(stage)")
    ['sex', 'stage']
    """
    import formulaic
    from formulaic.errors import FormulaicError

    text = formula.strip()
    right = text if text.startswith("~") else f"~ {text}"
    try:
        return sorted(map(str, formulaic.Formula(right).required_variables))
    except (FormulaicError, SyntaxError, ValueError, TypeError) as error:
        raise StudyError(
            f'the formula {formula!r} can\'t be read: {error}. Write it as "~ sex + age".'
        ) from error


def _columns_of_text(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """The columns whose cells are all text, as `read_table` returns them."""
    return [name for name in names if all(isinstance(cell, str) for cell in table[name])]


def _check_values(used: pd.DataFrame, variables: Sequence[str]) -> None:
    for name in variables:
        values = used[name]
        if values.isna().any():
            ids = list(used.loc[values.isna(), "case_id"])
            raise StudyError(
                f"the covariate {name} is empty for {len(ids)} cases: {', '.join(ids[:5])}. Fill "
                "it in, or exclude these cases (data.exclude) and run the study again."
            )
        if values.nunique() < 2:
            raise StudyError(
                f"the covariate {name} is constant: {values.iloc[0]} for all {len(values)} cases. "
                "Nothing can be compared along it; leave it out of the formula."
            )
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values):
            _check_groups(name, values)


def _check_groups(name: str, values: pd.Series) -> None:
    """Raise StudyError for a group of fewer than three."""
    counts = values.value_counts()
    if counts.min() < FEWEST_IN_GROUP:
        raise StudyError(
            f"the group {name} = {counts.idxmin()} has {counts.min()} of "
            f"{counted(len(values), 'case')}; "
            f"{FEWEST_IN_GROUP} or more a group are needed. Unite groups, or leave the covariate "
            "out."
        )


def _check_size(matrix: np.ndarray, names: Sequence[str], count: int) -> None:
    rank = int(np.linalg.matrix_rank(matrix))
    if rank < matrix.shape[1]:
        raise StudyError(
            f"the columns {', '.join(names[1:])} say the same in part: {matrix.shape[1]} columns "
            f"hold {rank} independent ones. Leave a covariate out of the formula."
        )
    most = count // CASES_PER_COLUMN - 1
    if matrix.shape[1] - 1 > most:
        raise StudyError(
            f"{count} cases can't carry the {matrix.shape[1] - 1} columns "
            f"{', '.join(names[1:])}: {CASES_PER_COLUMN} cases a column and as many for the mean "
            f"are needed, so {max(most, 0)} columns at most. Leave covariates out, or add cases."
        )


def _column(
    place: int, name: str, term: str, values: np.ndarray, bases: Mapping[str, str]
) -> Column:
    """bases: factor → the group that the others are held against."""
    factor, bracket, level = name.partition("[T.")
    if bracket and ":" not in name:
        text = f"{factor}: {level.rstrip(']')} against {bases[factor]}"
        return Column(place, term, text, 1.0)
    if set(np.unique(values)) <= {0.0, 1.0}:
        return Column(place, term, f"{name}: 1 against 0", 1.0)
    step = float(values.std(ddof=1))
    return Column(place, term, f"{name}: {step:.3g} more (1 SD)", step)

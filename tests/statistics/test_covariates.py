from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.data_prep.formats.tables import read_table, typed
from ssm_pipeline.records import StudyError
from ssm_pipeline.statistics.covariates import design_of, matched_to_cases

IDS = tuple(f"p{index:02d}" for index in range(20))


def table(**columns: Any) -> Any:
    generator = np.random.default_rng(0)
    content = {
        "participant_id": IDS,
        "sex": ["F", "M"] * 10,
        "age": generator.uniform(40, 80, 20),
        "site": ["a"] * 20,
    }
    return pd.DataFrame(content | columns)


def refused(match: Any, formula: Any = "~ sex + age", cases: Any = IDS, **columns: Any) -> None:
    with pytest.raises(StudyError, match=match):
        design_of(formula, matched_to_cases(table(**columns), cases))


def test_rows_come_in_the_order_of_the_cases() -> None:
    shuffled = table().sample(frac=1, random_state=3)
    rows = matched_to_cases(shuffled, IDS)
    assert tuple(rows["case_id"]) == IDS
    np.testing.assert_array_equal(rows["age"], table()["age"])


def test_ids_that_look_like_numbers_stay_as_they_are() -> None:
    rows = matched_to_cases(
        pd.DataFrame({"case_id": ["007", "010"], "age": [1, 2]}), ("010", "007")
    )
    assert list(rows["age"]) == [2, 1]


def test_ids_that_pandas_takes_for_missing_are_ids(tmp_path: Path) -> None:
    ids = ("NA", "nan", "None", "007", "null")
    rows = "".join(f"{case_id}\t{age}\n" for age, case_id in enumerate(ids))
    (tmp_path / "a.tsv").write_text("participant_id\tage\n" + rows + "n/a\tn/a\n")
    read = typed(read_table(tmp_path / "a.tsv"), ["age"])
    assert read["age"].isna().tolist() == [False] * 5 + [True]
    matched = matched_to_cases(read[:5], ids[::-1])
    assert tuple(matched["case_id"]) == ids[::-1]
    assert list(matched["age"]) == [4, 3, 2, 1, 0]


def test_a_formula_makes_its_columns() -> None:
    design = design_of("~ sex + age", matched_to_cases(table(), IDS))
    assert design.terms == ("sex", "age")
    assert design.columns[0].name == "sex: M against F"
    np.testing.assert_array_equal(design.matrix[:, 0], 1)
    np.testing.assert_array_equal(design.matrix[:, 1], [0, 1] * 10)
    assert design.columns[1].step == pytest.approx(table()["age"].std())
    crossed = design_of("sex * age", matched_to_cases(table(), IDS))
    assert crossed.terms == ("sex", "age", "sex:age")


def test_tables_that_do_not_fit_the_cases_are_refused() -> None:
    refused(r"1 in the model but not in the table: p20", cases=(*IDS, "p20"))
    refused(r"1 in the table but not in the model: p19", cases=IDS[:19])
    refused(r"1 in the table more than once: p00", participant_id=("p00", *IDS[:1], *IDS[2:]))
    with pytest.raises(StudyError, match="no column case_id or participant_id; its columns are id"):
        matched_to_cases(pd.DataFrame({"id": IDS}), IDS)


def test_covariates_that_say_nothing_are_refused() -> None:
    refused("the covariate site is constant: a for all 20 cases", "~ site")
    refused("the covariate age is empty for 1 cases: p19", age=[*range(19), None])
    refused("the group sex = X has 1 of 20 cases", sex=[*["F", "M"] * 9, "F", "X"])
    refused("columns hold 2 independent ones", "~ age + double", double=2 * table()["age"])


@pytest.mark.parametrize("formula", ["~ sex +* age", "~ (sex", "sex ~ age ~ site"])
def test_formulas_that_cannot_be_read_are_refused(formula: str) -> None:
    refused(r"formula .* can't be", formula)


def test_a_formula_with_an_unknown_name_says_which_are_known() -> None:
    refused("names hight, and the table has sex, age, site", "~ hight")
    refused("names no covariate", "~ 1")


def test_more_columns_than_the_cases_carry_are_refused_with_the_number_they_do() -> None:
    generator = np.random.default_rng(1)
    many = {f"x{index}": generator.standard_normal(20) for index in range(4)}
    refused("so 3 columns at most", "~ x0 + x1 + x2 + x3", **many)


def test_numbers_as_groups_are_named_by_the_group_they_are_held_against() -> None:
    stages = matched_to_cases(table(stage=[2, 3, 10, 2] * 5), IDS)
    design = design_of("~ C(stage)", stages)
    names = [column.name for column in design.columns]
    assert names == ["C(stage): 3 against 2", "C(stage): 10 against 2"]
    assert design.matrix[:, 2].sum() == 5
    (column,) = design_of("~ C(sex, contr.treatment('M'))", stages).columns
    assert column.name == "C(sex, contr.treatment('M')): F against M"
    refused("the group stage = 4 has 2 of 20 cases", "~ C(stage)", stage=[2, 3] * 9 + [4, 4])


def test_cells_of_a_file_are_cleaned_typed_and_refused_by_row(tmp_path: Path) -> None:
    def columns(name: str, cells: list[str]) -> list[str]:
        rows = "".join(f"{case},{cell}\n" for case, cell in zip(IDS, cells, strict=True))
        (tmp_path / "t.csv").write_text(f"case_id,{name}\n{rows}")
        design = design_of(f"~ {name}", matched_to_cases(read_table(tmp_path / "t.csv"), IDS))
        return [column.name for column in design.columns]

    assert columns("sex", ["M", "F", "F ", "M "] * 5) == ["sex: M against F"]
    assert columns("asthma", ["None", "mild"] * 10) == ["asthma: mild against None"]
    assert columns("region", ["NA", "EU"] * 10) == ["region: NA against EU"]
    assert columns("age", [f'"{50 + k},5"' for k in range(20)])[0].startswith("age: 5.92 more")
    with pytest.raises(StudyError, match="age holds numbers, but '>89'"):
        columns("age", [">89", *(str(50 + k) for k in range(19))])


def test_rows_of_cases_that_the_run_left_out_are_not_used() -> None:
    with_dropped = pd.concat([table(), table().iloc[:1].assign(participant_id="dropped")])
    rows = matched_to_cases(with_dropped, IDS, left_out=["dropped", "another"])
    assert tuple(rows["case_id"]) == IDS
    with pytest.raises(StudyError, match=r"not in the model: dropped.*delete the rows of other"):
        matched_to_cases(with_dropped, IDS)
    with pytest.raises(StudyError, match=r"in the table: p19.*add the missing rows, or exclude"):
        matched_to_cases(table()[:19], IDS)

"""Tables, curves, landmarks, packing, colours: the page's parts, by known answers."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.report.curves import curve, quality_curves
from ssm_pipeline.report.grid_pattern import pattern_colours, patterned_scenes
from ssm_pipeline.report.headings import heading, headings, whole_heading
from ssm_pipeline.report.landmarks import carry_landmarks
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.tables import Cell, flattened, p_text, readable


def shown(table: pd.DataFrame) -> list[tuple[str, ...]]:
    return [tuple(cell.text for cell in row) for row in readable(table).rows]


def test_headings_carry_units() -> None:
    assert heading("volume_ml") == "Volume (ml)"
    assert heading("hd95_mm") == "95th percentile (mm)"
    assert heading("min_angle_deg") == "Smallest angle (degrees)"
    assert heading("case_id") == "Case"
    assert whole_heading("to_case_mm") == "Template to case, mean (mm)"


def test_columns_that_begin_alike_share_a_heading() -> None:
    columns = ["case_id", "surface_mean_mm", "surface_hd95_mm", "to_case_mm", "modes"]
    found = headings(columns)
    assert [h.group for h in found] == ["", "Surface distance", "Surface distance", "", ""]
    # A group of one is no group: its heading says all.
    assert [h.text for h in found[1:4]] == [
        "Mean (mm)",
        "95th percentile (mm)",
        "Template to case, mean (mm)",
    ]
    table = readable(pd.DataFrame([[0.5, 1, 2, 3, 4], [1.5, 2, 3, 4, 5]], columns=columns))
    assert table.groups == (("", 1), ("Surface distance", 2), ("", 1), ("", 1))


def test_numbers_are_rounded_by_column_and_errors_joined() -> None:
    table = pd.DataFrame(
        {
            "case_id": ["a", "b"],
            "chamfer_mm": [2.0, 2.4567],
            "chamfer_se_mm": [0.051, np.nan],
            "euler_number": [2.0, np.nan],
            "warnings": [("cut", "small"), ()],
        }
    )
    result = readable(table)
    assert result.headings[1].text == "Chamfer (mm)"
    assert shown(table) == [("a", "2.00 ± 0.05", "2", "cut; small"), ("b", "2.46", "–", "")]
    assert result.is_number == (False, True, True, False)


def test_intervals_are_joined() -> None:
    table = pd.DataFrame(
        {"border_mm": [12.25, 13.0], "border_low_mm": [12.0, 12.5], "border_high_mm": [12.5, 13.5]}
    )
    assert shown(table)[0] == ("12.2 (12.0 to 12.5)",)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("/home/ann/study 7/masks", "masks"),
        ("C:\\Users\\ann\\masks", "masks"),
        ("../../private/masks/", "masks"),
        ("data: /mnt/x/case_7.nii.gz: damaged", "data: case_7.nii.gz: damaged"),
        ("imagesTr/*.nii.gz", "imagesTr/*.nii.gz"),  # a pattern below the folder
        ("template/case, mm/ml", "template/case, mm/ml"),
        ("['full', 'S3M']", "['full', 'S3M']"),
    ],
)
def test_no_folder_is_named_on_a_page_that_may_be_sent(words: str, shown: str) -> None:
    assert dict(flattened({"data": {"folder": words}})) == {"data.folder": shown}
    cell = readable(pd.DataFrame({"warnings": [words]})).rows[0][0]
    assert (cell.text, cell.values) == (shown, (shown,))


def test_long_ids_are_short_and_whole_on_hover() -> None:
    table = readable(pd.DataFrame({"case_id": ["x" * 60, "b"]}), {"x" * 60: "…x"})
    assert table.rows[0] == (Cell("…x", "x" * 60, ("x" * 60,)),)
    assert table.rows[1] == (Cell("b", "b", ("b",)),)


def test_what_every_row_says_is_told_once() -> None:
    table = readable(
        pd.DataFrame(
            {
                "case_id": ["a", "b"],
                "points": [4000, 4000],
                "to_case_mm": [1e-15, 3e-15],
                "warnings": ["", ""],
                "x_mm": [1.0, 2.0],
            }
        )
    )
    assert [h.text for h in table.headings] == ["Case", "X (mm)"]
    assert table.shared == (("Points", "4000"), ("Template to case, mean (mm)", "0"))


def test_one_row_keeps_its_columns() -> None:
    assert len(readable(pd.DataFrame({"case_id": ["a"], "points": [4000]})).headings) == 2


def test_round_off_of_a_zero_is_a_plain_zero() -> None:
    table = pd.DataFrame({"x_mm": [-1e-15, 0.0], "y": [1, 2]})
    assert readable(table).shared == (("X (mm)", "0"),)
    assert shown(pd.DataFrame({"x_mm": [-0.001, 1.25]}))[0] == ("−0.001",)


def test_tiny_p_values_are_not_written_as_zero() -> None:
    assert [p_text(p) for p in (0.5, 0.0312, 2e-9, float("nan"))] == [
        "0.500",
        "0.031",
        "< 0.001",
        "–",
    ]


def test_nested_settings_become_dotted_names() -> None:
    assert list(flattened({"a": {"b": 1, "c": {"d": "x"}}, "e": 2})) == [
        ("a.b", "1"),
        ("a.c.d", "x"),
        ("e", "2"),
    ]


def test_curves_average_cases_and_keep_given_errors() -> None:
    cases = pd.DataFrame(
        {"case_id": ["a", "b", "a", "b"], "modes": [1, 1, 2, 2], "chamfer_mm": [1.0, 3.0, 1.0, 1.0]}
    )
    found = curve(cases, "chamfer_mm")
    assert found["value"].tolist() == [2.0, 1.0]
    # Standard deviation √2 over √2 cases.
    assert found["se"].tolist() == pytest.approx([1.0, 0.0])
    averaged = pd.DataFrame({"modes": [1], "chamfer_mm": [2.0], "chamfer_se_mm": [0.25]})
    assert curve(averaged, "chamfer_mm")["se"].tolist() == [0.25]


def test_compactness_is_shown_in_percent() -> None:
    tables = {"compactness": pd.DataFrame({"modes": [1, 2], "share": [0.6, 1.0]})}
    assert quality_curves(tables)["compactness"]["value"].tolist() == pytest.approx([60, 100])


def test_landmarks_move_with_their_triangle() -> None:
    template = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
    faces = np.array([[0, 1, 2]])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shapes = np.stack([2 * template + 1, template @ turn.T])
    point = np.array([[1.0, 2.0, 0.0]])
    carried = carry_landmarks(point, template, faces, shapes)
    np.testing.assert_allclose(carried[:, 0], [[3, 5, 1], [-2, 1, 0]], atol=1e-12)


def test_packed_points_are_within_half_a_step() -> None:
    points = np.random.default_rng(0).uniform(-150, 150, (40, 3))
    faces = np.array([[0, 1, 2], [3, 4, 70000]])
    block = Block()
    odd = block.add_indices(np.array([1, 2, 3]))  # 6 bytes: the next array must still be aligned
    place, index_place = block.add_numbers(points), block.add_indices(faces)
    data = base64.b64decode(block.base64())
    assert place["offset"] % 4 == 0
    assert odd["type"] == "uint16"
    raw = np.frombuffer(data, "<i2", points.size, place["offset"])
    back = (place["origin"] + place["scale"] * raw).reshape(points.shape)
    assert np.abs(back - points).max() <= place["scale"] / 2 * 1.001
    assert place["scale"] < 300 / 65000
    assert index_place["type"] == "uint32"
    indices = np.frombuffer(data, "<u4", 6, index_place["offset"])
    np.testing.assert_array_equal(indices.reshape(2, 3), faces)


def test_round_numbers() -> None:
    assert [round_up(v) for v in (0.3, 1.0, 7.0, 12.0)] == pytest.approx([0.5, 1, 10, 20])
    assert round_up(12.0, FINE) == pytest.approx(15)


def test_grid_lines_lie_on_planes_and_a_touching_plane_paints_no_blot() -> None:
    template = np.array([[-50.0, -50, -50], [50, 50, 50]])
    on_line, between = [20.3, 5.0, 5.0], [25.0, 5.0, 5.0]
    up, sideways = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    colours = pattern_colours(
        np.array([on_line, between, on_line]), np.array([up, up, sideways]), template, 10.0
    )
    # Positions y = z = 5 are half way between planes; only x decides.
    assert colours.sum(axis=1)[0] < 200
    assert (colours.sum(axis=1)[1:] > 200).all()


def test_patterned_shapes_keep_surface_and_welds(content: Any) -> None:
    template, faces = content.template_vertices, content.model.faces
    (scene,) = patterned_scenes([content.model.mean], faces, template, steps=3)
    assert len(scene.faces) == 9 * len(faces)
    # A closed triangle mesh keeps V − E + F = 2, so V = F / 2 + 2 only if edges are welded.
    assert len(scene.vertices) == len(scene.faces) // 2 + 2
    assert scene.colours is not None
    assert len(scene.colours) == len(scene.vertices)

"""The printed sheet and the program's model of it agree."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from ikservo.apps.calibrating.touch_procedure import place_sheet
from tests.calibration.mounted_arms import load_model

ROOT = Path(__file__).parents[3]
DRAWING = (ROOT / "docs" / "touch-grid.svg").read_text()


def drawn():
    """Return the middle of each cross on the sheet, mm from its upper left corner, by name."""
    circles = re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', DRAWING)
    names = re.findall(r">([A-E][1-4])<", DRAWING)
    return {n: np.array([float(x), float(y)]) for n, (x, y) in zip(names, circles, strict=True)}


def test_touch_sheet_in_docs_equals_generated_drawing():
    assert runpy.run_path(str(ROOT / "tools" / "touch_grid.py"))["drawing"]() == DRAWING


@pytest.mark.parametrize("name", ["so101", "so100"])
def test_touch_sheet_distances_equal_those_of_drawing(name):
    paper, (_, places) = drawn(), place_sheet(load_model(name), None, None)
    assert [place.name for place in places] == list(paper)
    for one in places:
        for other in places:
            between = np.linalg.norm(one.position_m - other.position_m)
            assert between == pytest.approx(
                np.linalg.norm(paper[one.name] - paper[other.name]) / 1000
            )


def test_touch_sheet_columns_go_right_and_rows_away_from_arm():
    _, places = place_sheet(load_model("so101"), 0.1, None)
    at = {place.name: place.position_m for place in places}
    assert at["A1"][1] > 0 > at["E1"][1]
    assert at["C4"][0] > at["C1"][0]
    np.testing.assert_allclose(at["C1"], (0.13, 0.0, 0.0), atol=1e-3)


def test_every_second_touch_point_is_on_top_of_block():
    _, places = place_sheet(load_model("so101"), 0.1, 0.04)
    heights = [round(float(place.position_m[2]), 6) for place in places]
    assert heights == [0.0, 0.04] * 10
    assert places[1].name == "B1 block"


def test_touch_sheet_scale_bar_is_100_mm_long():
    assert "h100m0" in DRAWING
    assert 'width="297mm" height="210mm" viewBox="0 0 297 210"' in DRAWING

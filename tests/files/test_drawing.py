"""Drawings from CSV and SVG files: units, places, and refusals with their line."""

import builtins
import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, FileFormatError, InputError
from ikservo.files.drawing import Drawing, read_drawing

PIXEL_M = 0.0254 / 96
HEAD = '<svg xmlns="http://www.w3.org/2000/svg">'


def csv(folder, text):
    path = folder / "strokes.csv"
    path.write_text(text)
    return path


def svg(folder, body, size='width="100mm" height="50mm" viewBox="0 0 200 100"'):
    path = folder / "drawing.svg"
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{body}</svg>')
    return path


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("0.1,0.2\n0.3,0.4\n", None, [[0.1, 0.2, 0.0], [0.3, 0.4, 0.0]]),
        ("x,y,z\n0.1,0.2,0.3\n", None, [[0.1, 0.2, 0.3]]),
        ("x_mm,y_mm\n100,200\n", None, [[0.1, 0.2, 0.0]]),
        ("x_m, y_m, z_m\n1,2,3", None, [[1.0, 2.0, 3.0]]),
        ("100,200\n", "mm", [[0.1, 0.2, 0.0]]),
        ("x,y\n100,200\n", "mm", [[0.1, 0.2, 0.0]]),
        ("# a comment\n\n1,2\n# another\n3,4\n", None, [[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]),
    ],
)
def test_csv_drawing_is_in_metres_or_its_stated_unit(tmp_path, text, unit, expected):
    (stroke,) = read_drawing(csv(tmp_path, text), unit).strokes_m
    np.testing.assert_allclose(stroke, expected)


def test_csv_drawing_empty_line_begins_a_new_stroke(tmp_path):
    drawing = read_drawing(csv(tmp_path, "x_mm,y_mm\n0,0\n1,0\n\n\n5,5\n6,5\n\n"))
    assert [len(stroke) for stroke in drawing.strokes_m] == [2, 2]


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("", None, "is empty"),
        ("x,y\n", None, "has no points"),
        ("# nothing\n", None, "has no points"),
        ("1,2\n3;4\n", None, 'line 2: "3;4" is not a list of numbers'),
        ("1,2\nnan,4\n", None, 'line 2: "nan,4" is not finite'),
        ("1,2\n1,inf\n", None, "line 2"),
        ("1,2\n3,4,5\n", None, "line 2: has 3 numbers"),
        ("1\n", None, "line 1: has 1 numbers"),
        ("x_mm,y_m\n1,2\n", None, "mixes units"),
        ("x_mm,y_mm\n1,2\n", "m", "unit is m, and mm in the header"),
        ("1,2\n", "inch", 'unit is "inch"'),
        ("a,b\n1,2\n", None, 'line 1: "a,b" is not a list of numbers'),
        ("\n".join(f"{i},0" for i in range(20_001)), None, "more than 20000 points"),
    ],
)
def test_invalid_csv_drawing_is_refused_with_line_number(tmp_path, text, unit, message):
    with pytest.raises(InputError, match=message):
        read_drawing(csv(tmp_path, text), unit)


def test_error_names_missing_drawing_file(tmp_path):
    with pytest.raises(FileFormatError, match=r"nowhere\.csv: does not exist"):
        read_drawing(tmp_path / "nowhere.csv")


def test_svg_drawing_keeps_size_and_axis_directions(tmp_path):
    # 200 by 100 units are 100 by 50 mm: a line right, then up, as the reader of the page sees it
    (stroke,) = read_drawing(svg(tmp_path, '<path d="M 20,80 h 40 v -60"/>')).strokes_m
    expected = [[0.0, 0.0, 0.0], [0.0, -0.02, 0.0], [0.03, -0.02, 0.0]]
    np.testing.assert_allclose(stroke, expected, atol=1e-6)


def test_svg_pixel_without_document_size_is_a_96th_of_an_inch(tmp_path):
    (stroke,) = read_drawing(svg(tmp_path, '<path d="M 0,0 H 96"/>', "")).strokes_m
    assert np.ptp(stroke[:, 1]) == pytest.approx(0.0254)


def test_svg_transforms_shapes_and_curves_are_drawn(tmp_path):
    body = '<g transform="translate(30,0) scale(2)"><circle cx="10" cy="10" r="5"/></g>'
    (stroke,) = read_drawing(svg(tmp_path, body, "")).strokes_m
    center = stroke.min(axis=0) + np.ptp(stroke, axis=0) / 2
    radii = np.linalg.norm(stroke - center, axis=1)
    np.testing.assert_allclose(radii, 10 * PIXEL_M, rtol=1e-3)
    np.testing.assert_allclose(stroke[0], stroke[-1], atol=1e-9)


def test_svg_path_move_begins_a_new_stroke(tmp_path):
    drawing = read_drawing(svg(tmp_path, '<path d="M0,0 h5 M10,10 h5 z"/><line x1="1" x2="3"/>'))
    assert len(drawing.strokes_m) == 3


def test_svg_text_is_skipped_and_reported(tmp_path):
    drawing = read_drawing(svg(tmp_path, '<path d="M0,0 h5"/><text>hi</text>'))
    assert drawing.ignored == ("text, which must be converted to paths first",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "is not XML"),
        ("<svg", "is not XML"),
        ("<html/>", 'is XML with root "html"'),
        ("<svg/>", "has no lines to draw"),
        ('<!DOCTYPE s [<!ENTITY a "b">]><svg>&a;</svg>', "is not XML"),
        ('<svg xmlns="http://www.w3.org/2000/svg"><text>hi</text></svg>', "no lines to draw"),
        (f'{HEAD}<path d="M0,0 Lnan,1"/></svg>', "no lines to draw"),
        (f'{HEAD}<path d="M0,0 L1e999,1"/></svg>', "not finite"),
    ],
)
def test_unusable_svg_is_refused_with_its_reason(tmp_path, text, message):
    path = tmp_path / "bad.svg"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_drawing(path)


def test_svg_drawing_refuses_a_unit(tmp_path):
    with pytest.raises(InputError, match="SVG has its own unit"):
        read_drawing(svg(tmp_path, '<path d="M0,0 h5"/>'), "mm")


def test_svg_drawing_without_svgelements_says_what_to_install(tmp_path, monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "svgelements":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match="needs svgelements") as raised:
        read_drawing(svg(tmp_path, '<path d="M0,0 h5"/>'))
    assert "[draw]" in raised.value.hint


def corner():
    return Drawing((np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.04, 0.0]]),))


def test_drawing_is_scaled_to_given_width_and_placed():
    drawing = corner().with_width(0.05)
    np.testing.assert_allclose(drawing.size_m, (0.05, 0.02))
    (stroke,) = drawing.placed((0.2, 0.1, 0.3), math.pi / 2).strokes_m
    np.testing.assert_allclose(stroke[-1], (0.2 - 0.02, 0.1 + 0.05, 0.3))


@pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
def test_drawing_refuses_invalid_scale_and_width(factor):
    with pytest.raises(BadValueError):
        corner().scaled(factor)
    with pytest.raises(BadValueError):
        corner().with_width(factor)


def test_single_point_drawing_refuses_a_width():
    with pytest.raises(BadValueError, match="a single point"):
        Drawing((np.zeros((1, 3)),)).with_width(0.1)


def test_simplified_drawing_keeps_corners_and_shape():
    angles = np.linspace(0.0, math.pi, 2000)
    arc = 0.03 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    across = np.linspace(arc[-1], (0.0, -0.05, 0.0), 500)
    (stroke,) = Drawing((np.concatenate([arc, across[1:]]),)).simplified().strokes_m
    assert len(stroke) < 50
    corner = int(np.flatnonzero((stroke == arc[-1]).all(axis=1))[0])
    assert len(stroke) == corner + 2  # the straight line is two points
    middles = (stroke[1 : corner + 1] + stroke[:corner]) / 2
    assert np.linalg.norm(middles, axis=1).min() > 0.03 - 5.1e-5

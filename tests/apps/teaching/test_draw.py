"""``ikservo draw``: files, placement, previews and refusals."""

import pytest

SIM = "--arm so101 --port sim:?pose=home"
AT = "--origin 0.18,-0.02,0.08"


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.csv"
    path.write_text("x_mm,y_mm\n0,0\n40,0\n40,40\n\n10,10\n20,10\n")
    return path


@pytest.mark.full
def test_csv_drawing_is_executed_and_reports_like_a_move(run_cli, square):
    result = run_cli(f"draw {square} {AT} --scale 0.5 --tool-speed 40 {SIM} --json")
    assert result.code == 0
    assert result.json["schema"] == "ikservo/move/1"
    assert result.json["target_m"] == pytest.approx((0.19, -0.015, 0.09))
    assert result.json["path_error_max_m"] > 0.0


def test_draw_command_prints_size_and_origin_before_motion(run_cli, square):
    result = run_cli(f"draw {square} {AT} --dry-run {SIM}")
    assert result.err.splitlines()[0] == (
        "2 strokes, 40 mm along x and 40 mm along y, origin at (0.180, -0.020, 0.080) m."
    )
    assert "path" in result.out


def test_svg_is_scaled_to_width_and_skipped_text_is_reported(run_cli, tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><rect width="30" height="60"/><text>x</text></svg>'
    )
    result = run_cli(f"draw {path} --origin 0.17,0.01,0.08 --width 40mm --dry-run {SIM}")
    assert result.code == 0
    assert result.err.startswith("1 stroke, 40 mm along x and 20 mm along y")
    assert "Not drawn: text" in result.err


def test_drawing_without_origin_starts_at_tip(run_cli, square):
    result = run_cli(f"draw {square} --scale 0.5 --rotate 180 --dry-run {SIM} --json")
    assert result.code == 0
    assert result.json["target_m"][0] == pytest.approx(0.217 - 0.01, abs=5e-3)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("draw nowhere.csv", 2, "nowhere.csv: does not exist"),
        ("draw {folder}", 2, "is a folder"),
        ("draw {square} --origin 0.2,0", 2, "is not a point"),
        ("draw {square} --scale 0", 2, "scale of the drawing is 0"),
        ("draw {square} --scale nan", 2, "nan is not a number"),
        ("draw {square} --width -0.1", 2, "scale of the drawing"),
        ("draw {square} --width 0.1 --scale 2", 2, "given twice"),
        ("draw {square} --unit m", 2, "mm in the header"),
        ("draw {square} --lift -1mm", 2, "lift of the tool"),
        ("draw {square} --tool-speed 0", 2, "not a speed above 0"),
        ("draw {square} --scale 100 --origin 0.2,0,0.1", 7, "point 2 of stroke 1"),
        ("draw {square} --origin 0.2,0,-0.03", 8, "the table"),
        ("draw", 2, "Missing argument"),
    ],
)
def test_invalid_drawing_command_is_refused(run_cli, square, words, code, message):
    result = run_cli(f"{words.format(square=square, folder=square.parent)} {SIM}")
    assert result.code == code
    assert message in result.err
    assert result.out == ""

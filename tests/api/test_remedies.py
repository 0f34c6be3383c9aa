"""Errors name methods in a program, and commands at the command line."""

import ast
import re
from pathlib import Path

import pytest

import ikservo
from ikservo.cli import main
from ikservo.remedies import in_page, in_python

SOURCES = Path(ikservo.__file__).parent
# What only commands do, and what is said on a terminal or a page only.
COMMANDS_ONLY = re.compile(
    r"cli/|apps/(agent|page|calibrating|importing|lab|workbench)/|calibration/|maintenance/|core\.py"
    r"|planning/calibrated_arm|apps/teaching/(dataset|lerobot_|hand_guiding)|apps/\w+/__init__"
    r"|apps/remote/zenoh_session|apps/cameras/(calibrate_|camera_by|camera_cal|camera_check|camera_dialogue|tip_)"
    r"|apps/cameras/picture_folder|apps/\w+/\w+_command"
)
OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
REPLACED = re.compile(r"ikservo (relax|where|stop|joints|pose|move)\b")


@pytest.mark.parametrize(
    ("at_a_terminal", "in_a_program"),
    [
        ("Release it with: ikservo relax", "Release it with: arm.relax()"),
        ("Try: ikservo move 0.477 -0.010 0.108", "Try: arm.move_to((0.477, -0.01, 0.108))"),
        ("Check its alarms: ikservo where", "Check its alarms: arm.where()"),
        ("Without an arm: --port sim", 'Without an arm: port="sim"'),
        ("Use --port sim, or another", 'Use port="sim", or another'),
        ("another file, or add --overwrite.", "another file, or add overwrite=True."),
        ("or --no-collision if you can see", "or open_arm(..., collisions=False) if you can see"),
        ("Give --arm, as in --arm so101.", 'Name it, as in open_arm("so101").'),
        ("Calibrate it: ikservo calibrate so101", "Calibrate it: ikservo calibrate so101"),
        ("Choose it with tip (--tip): base.", "Choose it with tip: base."),
        ("Choose another: --foxglove-port 8766", "Choose another: foxglove_port=8766"),
        ("", ""),
    ],
)
def test_terminal_hint_is_rewritten_for_program(at_a_terminal, in_a_program):
    assert in_python(at_a_terminal) == in_a_program


@pytest.mark.parametrize(
    ("at_a_terminal", "on_a_page"),
    [
        ("Let it cool down: ikservo relax", "Let it cool down: acknowledge, then press Relax"),
        (
            "The arm holds its position. See: ikservo where",
            "The arm holds its position. See Health on this page",
        ),
        ("Check its alarms: ikservo where", "Check its alarms: see Health on this page"),
        ("Calibrate it: ikservo calibrate so101. Then", "Calibrate it: press Calibrate. Then"),
        ("If it stays: ikservo recover", "If it stays, in a terminal: ikservo recover"),
        (
            "One at a time: ikservo setup ARM. Then: ikservo doctor",
            "One at a time: press Set up servos in the list of arms. "
            "Then: press Check in the list of arms",
        ),
        (
            "Set them: ikservo doctor --write-eeprom",
            "Set them, in a terminal: ikservo doctor --write-eeprom",
        ),
        ("", ""),
    ],
)
def test_terminal_hint_is_rewritten_for_page(at_a_terminal, on_a_page):
    assert in_page(at_a_terminal) == on_a_page


def texts():
    """Yield every text of the packages that a program calls, without docstrings."""
    for path in sorted(SOURCES.rglob("*.py")):
        place = path.relative_to(SOURCES).as_posix()
        if COMMANDS_ONLY.match(place) or place == "remedies.py":
            continue
        tree = ast.parse(path.read_text())
        text_ids = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
            if is_text and id(node) not in text_ids:
                yield place, node.value


@pytest.mark.full
def test_api_messages_name_python_methods_instead_of_commands():
    left = [
        (place, text)
        for place, text in texts()
        if OPTION.search(in_python(text)) or REPLACED.search(f"{in_python(text)} ")
    ]
    ours = [
        each
        for each in left
        if not re.search(
            r"pip (un)?install|uninstall --yes|--force-reinstall|arms new|--think |--camera 0",
            each[1],
        )
    ]
    assert [each for each in ours if not each[1].endswith("ikservo move ")] == []


def message_of(do):
    with pytest.raises(ikservo.IkservoError) as caught:
        do()
    return str(caught.value)


def test_unreachable_point_error_suggests_call_that_works():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        text_ids = message_of(lambda: arm.move_to((0.9, 0.0, 0.1)))
        point = re.search(r"arm\.move_to\(\((.*)\)\)", text_ids)
        assert arm.plan_to([float(x) for x in point[1].split(",")]).duration_s > 0.0


def test_stopped_arm_error_names_acknowledge_call():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.stop("enough")
        assert "arm.acknowledge()" in message_of(lambda: arm.move_joints({"shoulder_pan": 0.1}))


def test_existing_recording_error_names_overwrite_argument(tmp_path):
    (tmp_path / "a.jsonl").write_text("")
    with ikservo.open_arm("so101", port="sim") as arm:
        text_ids = message_of(lambda: arm.record(tmp_path / "a.jsonl", duration_s=0.1))
    assert "overwrite=True" in text_ids


def test_command_line_error_suggests_command_to_try(capsys):
    words = ["move", "0.9", "0", "0.1", "--arm", "so101", "--port", "sim", "--yes"]
    assert main(words) == 7
    assert re.search(
        r"Try: ikservo move \S+ \S+ \S+ --arm so101 --port sim", capsys.readouterr().err
    )

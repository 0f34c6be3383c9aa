"""A user with a description and a box of servos makes the arm, calibrates it and moves it."""

import json
import re

import pytest

from tests.apps.importing.hidden_arm import IDS, SIGNS, hide_arm
from tests.journeys.terminal import Terminal
from tests.oracle import CONFIGS


@pytest.fixture
def terminal(tmp_path):
    return Terminal(100, {"IKSERVO_HOME": str(tmp_path / "home")})


def test_new_arm_moves_after_three_commands(terminal, tmp_path):
    hidden = hide_arm(tmp_path / "hidden")
    typed = [("Which link is the tip?", "\n")]
    for name in sorted(IDS, key=IDS.get):
        way = "yes" if SIGNS[name] > 0 else "no"
        typed += [("Move it? [y/n]", "y\n"), ("Which joint moved?", f"{name}\n"),
                  ("Did it first move", f"{way}\n")]  # fmt: skip
    made = terminal.run(
        "arms", "new", "mine", "--from", CONFIGS / "so101" / "arm.urdf", "--folder", tmp_path,
        "--port", f"sim:{hidden}?pose=home", typed=typed,
    )  # fmt: skip
    assert made.code == 0, made.text
    arm = tmp_path / "mine"
    # What the simulated hands hold is the pose rest of their own file: that of the new arm.
    rest = re.compile(r"\[poses\.rest\]\n.*?\n(?=\n|#|\[)", re.DOTALL)
    own = rest.search((arm / "arm.toml").read_text())[0]
    hidden.write_text(rest.sub(own, hidden.read_text()))
    calibrated = terminal.run("calibrate", arm, "--port", f"sim:{hidden}?hand=calibrate", "--yes")
    assert calibrated.code == 0, calibrated.text
    moved = terminal.run(
        "move", "0.22", "0.04", "0.15", "--arm", arm, "--port", f"sim:{hidden}?pose=home", "--yes",
        "--json",
    )  # fmt: skip
    assert moved.code == 0, moved.text
    result = next(json.loads(line) for line in moved.text.splitlines() if line.startswith("{"))
    assert result["reached"]

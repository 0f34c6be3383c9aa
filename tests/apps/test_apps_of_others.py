"""Apps and arms of other distributions, found by entry points; broken ones affect no command."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ikservo

CONFIGS = Path(__file__).parents[2] / "configs"

APP = """
from ikservo.app import App, Command

APP = App(
    name="nod",
    commands={"nod": Command("nod_app.command", "Nod with the arm.", "Move")},
    names={"nod_angle": "nod_app.motion:nod_angle"},
    arm_methods={"nod": "nod_app.motion:nod"},
    motions={"nod": "nod_app.motion:Nod"},
)
"""
COMMAND = '''
from ikservo.cli.terminal import print_lines

def command(word: str = "hello") -> None:
    """Print a word."""
    print_lines([word])
'''
MOTION = """
from dataclasses import dataclass

from ikservo.arm.own_motion import OwnMotion
from ikservo.planning.motions import MoveJoints, Speed

nod_angle = 0.1

@dataclass(frozen=True)
class Nod(OwnMotion[None]):
    speed: Speed = "normal"

    def run(self, arm, on_progress):
        here = arm.where().positions["elbow_flex"]
        for angle in (here + nod_angle, here):
            arm.execute(MoveJoints({"elbow_flex": angle}, speed=self.speed))

    def end(self, context, start):
        return start

def nod(arm, speed="normal"):
    return arm.execute(Nod(speed))
"""


@pytest.fixture
def other(tmp_path):
    """A folder on the path of a command, with another distribution in it."""
    package = tmp_path / "nod_app"
    package.mkdir()
    (package / "__init__.py").write_text(APP)
    (package / "command.py").write_text(COMMAND)
    (package / "motion.py").write_text(MOTION)
    install(tmp_path, "nod", "[ikservo.apps]\nnod = nod_app:APP\n")
    return tmp_path


def install(folder, name, entry_points):
    metadata = folder / f"{name}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)


def run(folder, *words):
    environment = {**os.environ, "PYTHONPATH": str(folder), "IKSERVO_HOME": str(folder / "home")}
    return subprocess.run([sys.executable, *words], env=environment, capture_output=True,
                          text=True, check=False, timeout=100)  # fmt: skip


def command(folder, *words):
    return run(folder, "-m", "ikservo", *words)


def test_command_of_plugin_distribution_is_listed_and_runs(other):
    assert "Nod with the arm." in command(other, "--help").stdout
    assert command(other, "nod", "--word", "hi").stdout == "hi\n"


@pytest.mark.full
def test_motion_of_plugin_is_arm_method_and_program_step(other):
    program = other / "nods.toml"
    program.write_text(
        'format = 1\narm = "so101"\n[[steps]]\npose = "home"\n[[steps]]\nmotion.nod = {}\n'
    )
    done = command(
        other, "program", "run", str(program), "--arm", "so101", "--port", "sim", "--yes"
    )
    assert (done.returncode, done.stderr.count("Error")) == (0, 0), done.stderr
    script = (
        "import ikservo\n"
        "with ikservo.open_arm('so101', port='sim') as arm:\n"
        "    arm.move_joints({'elbow_flex': 0.2})\n"
        "    arm.nod(speed='slow')\n"
        "    elbow_rad = arm.where().positions['elbow_flex']\n"
        "    print(round(elbow_rad, 1), ikservo.nod_angle, 'nod' in dir(arm))\n"
    )
    assert run(other, "-c", script).stdout == "0.2 0.1 True\n"


@pytest.mark.full
def test_example_app_of_documentation_runs(tmp_path):
    page = (CONFIGS.parent / "docs" / "how-to" / "write-an-app.md").read_text("utf-8")
    for name, text in re.findall(r"```python\n# (\S+)\n(.*?)```", page, re.DOTALL):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    install(tmp_path, "nod", "[ikservo.apps]\nnod = my_nod:APP\n")
    done = command(tmp_path, "nod", "--arm", "so101", "--port", "sim", "--yes")
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    script = "from my_nod.motion import panel; print(panel(None, {'elbow_flex': 0.5}).rows)"
    assert run(tmp_path, "-c", script).stdout == "[('elbow', '0.50 rad')]\n"


BROKEN = {
    "import error": ("import no_such_module\n", "No module named 'no_such_module'"),
    "wrong value": ("APP = 3\n", "is not an ikservo.app.App"),
    "prints": ("print('hello')\n" + APP, "prints while it is imported"),
    "clash": (APP.replace('"nod": Command', '"move": Command'), "a command 'move', which exists"),
    "bad place": (APP.replace(":Nod", ""), "is not a package.module:name"),
    "wrong type": ("from ikservo.app import App\nAPP = App(name='x', commands=3)\n", "wrong type"),
    "exits": ("raise SystemExit(3)\n", "SystemExit"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_warning_names_broken_app_in_one_sentence(other, kind):
    text, reason = BROKEN[kind]
    (other / "nod_app" / "__init__.py").write_text(text)
    listed = command(other, "--help")
    assert (listed.returncode, "Nod with" in listed.stdout) == (0, False)
    (sentence,) = listed.stderr.strip().splitlines()
    assert ("'nod'" in sentence, reason in sentence) == (True, True), sentence
    arms = command(other, "arms", "--json")
    assert (arms.returncode, arms.stderr) == (0, "")


def test_arms_of_plugin_distribution_are_found_by_name(other):
    shelf = other / "their_arms"
    shutil.copytree(CONFIGS / "planar2", shelf / "their_planar")
    (shelf / "__init__.py").touch()
    file = shelf / "their_planar" / "arm.toml"
    file.write_text(file.read_text().replace('"planar2"', '"their_planar"', 1))
    install(other, "arms", "[ikservo.arms]\ntheirs = their_arms\n")
    assert "their_planar" in command(other, "arms").stdout
    done = command(other, "solve", "0.1", "0.1", "0", "--arm", "their_planar")
    assert done.returncode in (0, 7), done.stderr


def test_damaged_arm_of_plugin_distribution_is_omitted(other):
    folder = other / "their_arms" / "damaged"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()
    (folder / "arm.toml").write_text("name = 3")
    install(other, "arms", "[ikservo.arms]\ntheirs = their_arms\n")
    listed = command(other, "arms")
    assert (listed.returncode, "so101" in listed.stdout) == (0, True)
    assert "damaged" in listed.stderr


def test_unknown_attribute_of_arm_or_package_is_reported():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = ikservo.no_such_name
    with (
        ikservo.open_arm("so101", port="sim") as arm,
        pytest.raises(AttributeError, match="no_such_name"),
    ):
        _ = arm.no_such_name

"""What a person installs carries the arms and the simulator."""

import os
import subprocess
import sys
import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from tests.oracle import ARMS

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder],
                   cwd=ROOT, check=True, capture_output=True)  # fmt: skip
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


def test_the_wheel_carries_every_arm(wheel):
    files = {f"ikservo/_configs/{arm}/{file}" for arm in ARMS for file in ("arm.toml", "arm.urdf")}
    assert files <= set(wheel.namelist())


def test_the_wheel_carries_the_udev_rule(wheel):
    rule = wheel.read("ikservo/_rules/60-ikservo.rules")
    assert rule == (ROOT / "tools" / "60-ikservo.rules").read_bytes()


def test_the_wheel_carries_the_page_of_the_view(wheel):
    page = {f"ikservo/view/page/{path.name}" for path in (ROOT / "ikservo/view/page").iterdir()}
    assert "ikservo/view/page/index.html" in page
    assert page <= set(wheel.namelist())


def test_the_wheel_carries_the_simulator_and_its_entry_points(wheel):
    names = wheel.namelist()
    assert "servosim/__init__.py" in names
    points = next(name for name in names if name.endswith("entry_points.txt"))
    assert "sim = servosim:open_port" in wheel.read(points).decode()


def test_the_unpacked_wheel_moves_an_arm(wheel, tmp_path):
    wheel.extractall(tmp_path)
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import ikservo;"
        "assert ikservo.__file__.startswith(sys.argv[1]);"
        "print(ikservo.open_arm('so101', port='sim').move_to((0.25, 0.05, 0.15)).reached)"
    )
    interpreted = os.environ | {"NUMBA_DISABLE_JIT": "1"}  # a new place: all would be compiled anew
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], cwd=tmp_path,
                          env=interpreted, capture_output=True, text=True, check=False)  # fmt: skip
    assert done.stdout.strip() == "True", done.stderr


def test_the_installed_package_finds_the_simulator():
    assert [point.value for point in entry_points(group="ikservo.ports", name="sim")] == [
        "servosim:open_port"
    ]

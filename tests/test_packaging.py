"""An installed package contains the arms and the simulator."""

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from ikservo.kernels.compiled import is_compiled
from tests.oracle import ARMS

pytestmark = pytest.mark.full  # the fixture takes long

ROOT = Path(__file__).parents[1]


def build_wheel(folder, **environment):
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    return subprocess.run(command, cwd=ROOT, env=os.environ | environment, check=False,
                          capture_output=True, text=True)  # fmt: skip


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    assert build_wheel(folder).returncode == 0
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


def test_wheel_contains_every_arm(wheel):
    files = {f"ikservo/_configs/{arm}/{file}" for arm in ARMS for file in ("arm.toml", "arm.urdf")}
    assert files <= set(wheel.namelist())


def test_wheel_contains_udev_rule(wheel):
    rule = wheel.read("ikservo/_rules/60-ikservo.rules")
    assert rule == (ROOT / "tools" / "60-ikservo.rules").read_bytes()


def test_wheel_contains_web_page_of_panel(wheel):
    page = {
        f"ikservo/apps/page/static/{path.name}"
        for path in (ROOT / "ikservo/apps/page/static").iterdir()
    }
    assert "ikservo/apps/page/static/index.html" in page
    assert page <= set(wheel.namelist())


def test_wheel_contains_three_js_as_built_with_licence(wheel):
    recorded, name = wheel.read("ikservo/apps/page/static/three.min.js.sha256").decode().split()
    module = wheel.read(f"ikservo/apps/page/static/{name}")
    assert hashlib.sha256(module).hexdigest() == recorded
    versions = json.loads((ROOT / "tools/vendor/package.json").read_text())["devDependencies"]
    release = versions["three"].split(".")[1]
    assert f'"{release}"'.encode() in module  # its REVISION
    assert b"MIT" in wheel.read(
        metadata(wheel, "licenses/ikservo/apps/page/static/three.LICENSE.txt")
    )


def test_wheel_contains_uplot_as_built_with_licence(wheel):
    recorded = wheel.read("ikservo/apps/page/static/uplot.min.js.sha256").decode().splitlines()
    names = [line.split()[1] for line in recorded]
    assert names == ["uplot.min.js", "uplot.min.css"]
    for line in recorded:
        module = wheel.read(f"ikservo/apps/page/static/{line.split()[1]}")
        assert hashlib.sha256(module).hexdigest() == line.split()[0]
    licence = wheel.read(metadata(wheel, "licenses/ikservo/apps/page/static/uplot.LICENSE.txt"))
    assert b"MIT" in licence


def test_wheel_contains_simulator_and_its_entry_point(wheel):
    names = wheel.namelist()
    assert "servosim/__init__.py" in names
    points = wheel.read(metadata(wheel, "entry_points.txt")).decode()
    assert "sim = servosim:open_port" in points


def metadata(wheel, file):
    return next(name for name in wheel.namelist() if name.endswith(f".dist-info/{file}"))


def test_unpacked_wheel_moves_arm(wheel, tmp_path):
    wheel.extractall(tmp_path)
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import ikservo;"
        "assert ikservo.__file__.startswith(sys.argv[1]);"
        "print(ikservo.open_arm('so101', port='sim').move_to((0.25, 0.05, 0.15)).reached)"
    )
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], cwd=tmp_path,
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.stdout.strip() == "True", done.stderr


def test_wheel_contains_compiled_kernels_and_platform_tag(wheel):
    if not is_compiled():
        pytest.skip("no C compiler")
    (tag,) = [
        line
        for line in wheel.read(metadata(wheel, "WHEEL")).decode().splitlines()
        if "Tag:" in line
    ]
    assert tag.startswith("Tag: cp311-abi3-")
    module = [name for name in wheel.namelist() if name.endswith((".so", ".pyd"))]
    assert module == [f"ikservo/kernels/{Path(module[0]).name}"]


def test_wheel_without_compiler_is_pure_python(tmp_path):
    done = build_wheel(tmp_path, IKSERVO_COMPILED="0")
    assert done.returncode == 0
    (path,) = tmp_path.glob("*-py3-none-any.whl")
    names = zipfile.ZipFile(path).namelist()
    assert not [name for name in names if name.endswith((".so", ".pyd"))]


def test_forced_compilation_without_working_compiler_fails(tmp_path):
    done = build_wheel(tmp_path, IKSERVO_COMPILED="1", CC="false")
    assert done.returncode != 0
    assert "not compiled" in done.stderr


def test_installed_package_finds_simulator_entry_point():
    assert [point.value for point in entry_points(group="ikservo.ports", name="sim")] == [
        "servosim:open_port"
    ]

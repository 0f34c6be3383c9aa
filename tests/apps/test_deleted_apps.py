"""Deleting the folder of an app deletes its commands and affects nothing else in the core."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ikservo
from ikservo.app_discovery import built_in_apps

ROOT = Path(ikservo.__file__).parents[1]
APPS = [app.name for app in built_in_apps() if app.name != "core"]

IMPORT_CORE = """
import importlib, pathlib, sys
root = pathlib.Path(sys.argv[1])
for path in sorted(root.rglob("*.py")):
    parts = path.relative_to(root.parent).with_suffix("").parts
    if "apps" not in parts and parts[-1] not in ("__main__", "__init__"):
        importlib.import_module(".".join(parts))
from ikservo.kernels.compiled import is_compiled
import ikservo
with ikservo.open_arm("so101", port="sim") as arm:
    arm.move_to((0.25, 0.0, 0.15))
print(is_compiled())
"""


@pytest.fixture(params=APPS)
def without(request, tmp_path):
    """Return a copy of the package without the folder of one app, and the app's value."""
    for source in ("ikservo", "configs", "sim"):
        ignored = shutil.ignore_patterns("__pycache__", "static")
        shutil.copytree(ROOT / source, tmp_path / source, ignore=ignored)
    shutil.rmtree(tmp_path / "ikservo" / "apps" / request.param)
    return tmp_path, next(app for app in built_in_apps() if app.name == request.param)


def run(folder, *words):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), str(folder / "sim")]),
        "IKSERVO_HOME": str(folder / "home"),
    }
    return subprocess.run([sys.executable, *words], env=environment, capture_output=True,
                          text=True, check=False, timeout=100, cwd=folder)  # fmt: skip


@pytest.mark.sample(3)
@pytest.mark.full
def test_core_works_if_any_one_app_is_deleted(without):
    folder, app = without
    listed = run(folder, "-m", "ikservo", "--help")
    assert listed.returncode == 0, listed.stderr
    words = {line.split()[1] for line in listed.stdout.splitlines() if len(line.split()) > 2}
    assert not words & {name for name, each in app.commands.items() if each.module}
    assert {"move", "where", "stop", "arms"} <= words
    done = run(folder, "-c", IMPORT_CORE, str(folder / "ikservo"))
    assert done.stdout == "True\n", done.stderr
    stopped = run(folder, "-m", "ikservo", "stop")
    assert stopped.returncode == 2, stopped.stderr
    for name in app.commands:
        gone = run(folder, "-m", "ikservo", *name.split())
        assert gone.returncode == 2, gone.stderr

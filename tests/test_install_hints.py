"""The hint to install an extra names the command that works for this copy of ikservo."""

import ast
import json
import re
import tomllib
from importlib.metadata import Distribution
from pathlib import Path

import pytest

import ikservo
from ikservo import remedies

FOLDER = Path("/home/ada/my arms/ikservo")
LOCAL = {"url": "file:///home/ada/my%20arms/ikservo", "dir_info": {}}
EDITABLE = LOCAL | {"dir_info": {"editable": True}}
GIT = {"url": "https://example.org/a/ikservo", "vcs_info": {"vcs": "git", "commit_id": "ab"}}
TAGGED = GIT | {"vcs_info": {"vcs": "git", "commit_id": "ab", "requested_revision": "v1"}}
RECEIPT = '[tool]\nrequirements = [{ name = "numpy" }, { name = "ikservo", extras = ["view"] }]\n'


class Installed(Distribution):
    """A distribution that was installed from a given source."""

    def __init__(self, origin):
        self.origin = origin

    def read_text(self, filename):
        return json.dumps(self.origin) if self.origin else None

    def locate_file(self, path):
        return path


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Pretend that this copy was installed from a given source, by a program that left a file."""

    def install(origin, left="", text="", pip=True):
        monkeypatch.setattr("importlib.metadata.distribution", lambda _: Installed(origin))
        monkeypatch.setattr(remedies.sys, "prefix", str(tmp_path))
        monkeypatch.setattr(remedies.sys, "executable", "/venv/bin/python")
        monkeypatch.setattr(remedies.shutil, "which", lambda _: "/venv/bin/pip" if pip else None)
        if left:
            (tmp_path / left).write_text(text)

    return install


@pytest.mark.parametrize(("origin", "command"), [
    (None, 'pip install "ikservo[draw]"'),
    (LOCAL, f'pip install "{FOLDER}[draw]"'),
    (EDITABLE, f'pip install --editable "{FOLDER}[draw]"'),
    (GIT, 'pip install "ikservo[draw] @ git+https://example.org/a/ikservo"'),
    (TAGGED, 'pip install "ikservo[draw] @ git+https://example.org/a/ikservo@v1"'),
    ({"url": "file:///tmp/i.whl", "archive_info": {}}, 'pip install "/tmp/i.whl[draw]"'),
])  # fmt: skip
def test_install_hint_names_source_of_installed_copy(installed, origin, command):
    installed(origin)
    assert remedies.install_command("draw") == command


def test_install_hint_keeps_extras_of_uv_tool(installed):
    installed(LOCAL, "uv-receipt.toml", RECEIPT)
    assert remedies.install_command("draw") == f'uv tool install "{FOLDER}[draw,view]"'


def test_install_hint_repairs_uv_tool_installation(installed):
    installed(EDITABLE, "uv-receipt.toml", RECEIPT)
    assert remedies.install_command() == f'uv tool install --reinstall --editable "{FOLDER}[view]"'


def test_install_hint_for_pipx_installation_uses_pipx(installed):
    installed(LOCAL, "pipx_metadata.json", "{}")
    assert remedies.install_command("draw") == f'pipx install --force "{FOLDER}[draw]"'


def test_install_hint_names_python_if_pip_belongs_to_another(installed, monkeypatch):
    installed(None, pip=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    assert remedies.install_command() == '"/venv/bin/python" -m pip install "ikservo"'
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert remedies.install_command() == 'uv pip install --python "/venv/bin/python" "ikservo"'


def test_only_remedies_module_contains_pip_install_command():
    sources = Path(ikservo.__file__).parent
    named = [
        f"{path.name}:{node.lineno}"
        for path in [*sources.rglob("*.py"), *(sources.parent / "sim").rglob("*.py")]
        if path.name not in ("remedies.py", "ways_around.py")  # its extra goes with its planner
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and re.search(r"pip (un)?install", node.value)
    ]
    assert named == []


def test_readme_installation_includes_every_extra():
    root = Path(ikservo.__file__).parent.parent
    extras = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    assert "uv tool install '.[all]'" in (root / "README.md").read_text("utf-8")
    (everything,) = extras.pop("all")
    assert set(everything.removeprefix("ikservo[").rstrip("]").split(",")) == set(extras)

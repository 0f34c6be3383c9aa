"""Macros are expanded by `ikservo arms expand` alone, by xacro in an isolated Python."""

import importlib.util
from pathlib import Path

import pytest

import ikservo
from ikservo.errors import FileFormatError
from ikservo.model.urdf_xml import MAX_URDF_BYTES, expand_xacro
from tests.oracle import CONFIGS

MACROS = """<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="reach" value="${0.1 + 0.05}"/>
  <xacro:macro name="piece" params="name">
    <link name="${name}">
      <visual><geometry><box size="${reach} 0.02 0.02"/></geometry></visual>
    </link>
  </xacro:macro>
  <xacro:piece name="base"/>
  <xacro:piece name="arm"/>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="${reach} 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""

needs_xacro = pytest.mark.skipif(importlib.util.find_spec("xacro") is None, reason="no xacro")


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "two.urdf.xacro"
    path.write_text(MACROS)
    return path


@pytest.fixture
def no_child(monkeypatch):
    def refuse(*_, **__):
        pytest.fail("a process was started")

    monkeypatch.setattr("ikservo.model.urdf_xml.subprocess.run", refuse)


@needs_xacro
def test_expand_writes_the_urdf_beside_the_file(run_cli, path):
    assert run_cli(f"arms expand {path}").code == 0
    model = ikservo.load_model(path.with_suffix(""), tip="arm")
    assert model.chain.forward([0.0])[0, 3] == pytest.approx(0.15)


@needs_xacro
def test_expand_keeps_an_existing_urdf(run_cli, path):
    path.with_suffix("").write_text("mine")
    assert run_cli(f"arms expand {path}").code == 2
    assert path.with_suffix("").read_text() == "mine"


def test_loading_runs_no_xacro(path, no_child):
    with pytest.raises(FileFormatError, match="runs what is written in the file") as caught:
        ikservo.load_model(path, tip="arm")
    assert f"ikservo arms expand {path}" in caught.value.hint


def test_a_macro_in_a_urdf_names_the_command(path, no_child):
    plain = path.rename(path.with_suffix(""))
    with pytest.raises(FileFormatError, match="macros are not expanded") as caught:
        ikservo.load_model(plain, tip="arm")
    assert f"ikservo arms expand {plain}" in caught.value.hint


@needs_xacro
@pytest.mark.parametrize("place", ["the current folder", "PYTHONPATH"])
def test_expand_imports_nothing_from(place, path, tmp_path, monkeypatch):
    trap = tmp_path / "trap"
    trap.mkdir()
    (trap / "xacro.py").write_text(f"open({str(trap / 'ran')!r}, 'w')\ndef main(): print('x')\n")
    if place == "PYTHONPATH":
        monkeypatch.setenv("PYTHONPATH", str(trap))
    else:
        monkeypatch.chdir(trap)
    expand_xacro(path)
    assert not (trap / "ran").exists()


def test_without_xacro_the_error_says_what_to_install(path, monkeypatch):
    monkeypatch.setattr("ikservo.model.urdf_xml._MODULE", "no_such_module")
    with pytest.raises(FileFormatError, match="need xacro, which is not installed") as caught:
        expand_xacro(path)
    assert "pip install xacro" in caught.value.hint


@needs_xacro
def test_what_xacro_refuses_is_said_in_its_words(path):
    path.write_text(MACROS.replace("${reach} 0 0", "${no_such_length} 0 0"))
    with pytest.raises(FileFormatError, match=r"xacro refuses it: .*no_such_length"):
        expand_xacro(path)


@needs_xacro
@pytest.mark.parametrize(
    "expression",
    [f"${{'x' * {MAX_URDF_BYTES + 1}}}", "${len(range(10**9) and [0] * 10**9)}"],
    ids=["output", "memory"],
)
def test_an_expansion_is_bounded_in_its(expression, path):
    path.write_text(MACROS.replace("${reach} 0 0", expression))
    with pytest.raises(FileFormatError, match="xacro refuses it"):
        expand_xacro(path)


@needs_xacro
def test_the_simulator_takes_an_arm_whose_macros_were_expanded(run_cli, tmp_path):
    text = (CONFIGS / "so101" / "arm.urdf").read_text()
    macros = '<robot xmlns:xacro="http://ros.org/wiki/xacro" '
    (tmp_path / "arm.urdf.xacro").write_text(text.replace("<robot ", macros, 1))
    (tmp_path / "arm.toml").write_text((CONFIGS / "so101" / "arm.toml").read_text())
    run_cli(f"arms expand {tmp_path}/arm.urdf.xacro")
    assert run_cli(f"where --arm {tmp_path}/arm.toml --port sim").code == 0
    assert Path(tmp_path / "arm.urdf").is_file()


def test_a_missing_file_is_named():
    with pytest.raises(FileFormatError, match=r"nowhere\.xacro: it does not exist"):
        expand_xacro(Path("nowhere.xacro"))

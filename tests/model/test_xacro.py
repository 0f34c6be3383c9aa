"""Macros of a xacro file are expanded where xacro is installed; else the error says what to do."""

import shutil
import stat

import pytest

import ikservo
from ikservo.errors import FileFormatError

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


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "two.urdf.xacro"
    path.write_text(MACROS)
    return path


def test_macros_are_expanded(path):
    pytest.importorskip("xacro")
    model = ikservo.load_model(path, tip="arm")
    assert model.chain.forward([0.0])[0, 3] == pytest.approx(0.15)


def test_the_program_is_used_where_the_package_is_missing(path, tmp_path, monkeypatch):
    folder = tmp_path / "bin"
    folder.mkdir()
    joint = "<joint name='j' type='continuous'><parent link='base'/><child link='arm'/></joint>"
    plain = f"<robot name='plain'><link name='base'/><link name='arm'/>{joint}</robot>"
    program = folder / "xacro"
    program.write_text(f'#!/bin/sh\necho "{plain}"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    monkeypatch.setattr("ikservo.model.urdf_xml.importlib.util.find_spec", lambda _: None)
    assert ikservo.load_model(path, tip="arm").name == "plain"


def test_without_xacro_the_error_says_what_to_install(path, monkeypatch):
    monkeypatch.setattr("ikservo.model.urdf_xml.importlib.util.find_spec", lambda _: None)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(FileFormatError, match="need xacro, which is not installed") as caught:
        ikservo.load_model(path, tip="arm")
    assert "pip install xacro" in caught.value.hint


def test_what_xacro_refuses_is_said_in_its_words(path):
    pytest.importorskip("xacro")
    path.write_text(MACROS.replace("${reach} 0 0", "${no_such_length} 0 0"))
    with pytest.raises(FileFormatError, match=r"xacro refuses it: .*no_such_length"):
        ikservo.load_model(path, tip="arm")

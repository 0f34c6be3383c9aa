"""Only `ikservo arms new` expands macros: by xacro in an isolated Python."""

import importlib.util
from pathlib import Path

import pytest

import ikservo
from ikservo.apps.importing.packages import PackageFolders
from ikservo.apps.importing.xacro import expand_xacro
from ikservo.errors import FileFormatError
from ikservo.model.urdf_xml import MAX_URDF_BYTES
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

    monkeypatch.setattr("ikservo.apps.importing.xacro.subprocess.run", refuse)


@needs_xacro
def test_xacro_is_expanded_with_allow_xacro(run_cli, path, tmp_path):
    done = run_cli(f"arms new two --from {path} --folder {tmp_path} --allow-xacro")
    assert done.code == 0
    model = ikservo.load_model(tmp_path / "two")
    assert model.chain.forward([0.0], frame="arm")[0, 3] == pytest.approx(0.15)


def test_xacro_is_not_run_without_consent(run_cli, path, tmp_path, no_child):
    refused = run_cli(f"arms new two --from {path} --folder {tmp_path}")
    assert refused.code == 2
    assert "runs the Python expressions" in refused.err
    assert "--allow-xacro" in refused.err
    assert not (tmp_path / "two").exists()


def test_unused_xacro_property_does_not_run_code(run_cli, path, tmp_path, no_child):
    text = (CONFIGS / "so101" / "arm.urdf").read_text()
    head = '<robot xmlns:xacro="http://ros.org/wiki/xacro" '
    text = text.replace("<robot ", head, 1).replace(
        "</robot>", '<xacro:property name="width" value=".2"/></robot>'
    )
    path.write_text(text)
    plain = path.rename(path.with_suffix(""))
    assert run_cli(f"arms new mine --from {plain} --folder {tmp_path} --dry-run").code == 0


@needs_xacro
def test_xacro_receives_given_packages_and_arguments(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "part.xacro").write_text(
        '<robot xmlns:xacro="http://ros.org/wiki/xacro"><link name="$(arg link)"/></robot>'
    )
    path = tmp_path / "arm.xacro"
    path.write_text(
        '<robot name="a" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arg name="link" '
        'default="base"/><xacro:include filename="$(find my_parts)/part.xacro"/></robot>'
    )
    packages = PackageFolders(path, {"my_parts": tmp_path / "parts"})
    assert '<link name="foot"/>' in expand_xacro(path, packages, {"link": "foot"})
    with pytest.raises(FileFormatError, match='needs the package "my_parts"'):
        expand_xacro(path)


def test_load_model_never_runs_xacro(path, no_child):
    with pytest.raises(FileFormatError, match="can run code from the file") as caught:
        ikservo.load_model(path, tip="arm")
    assert f"ikservo arms new NAME --from {path}" in caught.value.hint


def test_urdf_macro_error_names_import_command(path, no_child):
    plain = path.rename(path.with_suffix(""))
    with pytest.raises(FileFormatError, match="macros are not expanded") as caught:
        ikservo.load_model(plain, tip="arm")
    assert f"ikservo arms new NAME --from {plain}" in caught.value.hint


@needs_xacro
@pytest.mark.parametrize("place", ["the current folder", "PYTHONPATH"])
def test_xacro_imports_nothing_from_folder_or_pythonpath(place, path, tmp_path, monkeypatch):
    trap = tmp_path / "trap"
    trap.mkdir()
    (trap / "xacro.py").write_text(f"open({str(trap / 'ran')!r}, 'w')\ndef main(): print('x')\n")
    if place == "PYTHONPATH":
        monkeypatch.setenv("PYTHONPATH", str(trap))
    else:
        monkeypatch.chdir(trap)
    expand_xacro(path)
    assert not (trap / "ran").exists()


def test_missing_xacro_says_what_to_install(path, monkeypatch):
    monkeypatch.setattr("ikservo.apps.importing.xacro._MODULE", "no_such_module")
    with pytest.raises(FileFormatError, match="need xacro, which is not installed") as caught:
        expand_xacro(path)
    assert "pip install" in caught.value.hint


@needs_xacro
def test_error_names_xacro_argument_without_value_and_option(path):
    path.write_text(MACROS.replace('name="base"/>', 'name="base$(arg dof)"/>'))
    with pytest.raises(FileFormatError, match="argument dof has no value") as caught:
        expand_xacro(path)
    assert "--xacro-arg dof:=VALUE" in caught.value.hint


@needs_xacro
def test_xacro_error_text_is_shown_to_user(path):
    path.write_text(MACROS.replace("${reach} 0 0", "${no_such_length} 0 0"))
    with pytest.raises(FileFormatError, match=r"xacro refuses it: .*no_such_length"):
        expand_xacro(path)


@needs_xacro
@pytest.mark.parametrize(
    "expression",
    [f"${{'x' * {MAX_URDF_BYTES + 1}}}", "${len(range(10**9) and [0] * 10**9)}"],
    ids=["output", "memory"],
)
def test_xacro_expansion_is_bounded_in_output_and_memory(expression, path):
    path.write_text(MACROS.replace("${reach} 0 0", expression))
    with pytest.raises(FileFormatError, match="xacro refuses it"):
        expand_xacro(path)


def test_error_names_missing_xacro_file():
    with pytest.raises(FileFormatError, match=r"nowhere\.xacro: it does not exist"):
        expand_xacro(Path("nowhere.xacro"))

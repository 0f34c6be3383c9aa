"""Mesh files of every format are read with bounds; unusable ones are named."""

import json
import struct

import numpy as np
import pytest
import trimesh

import ikservo
from ikservo.apps.importing import meshes
from ikservo.apps.importing.meshes import mesh_triangles
from ikservo.errors import FileFormatError, InputError
from ikservo.model.collision_capsules import collision_body
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Mesh


def link_like(kind):
    """Return a closed mesh like those of arms' links [m]."""
    if kind == "bar":
        return trimesh.creation.box((0.12, 0.03, 0.02))
    return trimesh.creation.icosphere(subdivisions=3, radius=0.03)


def ascii_stl(mesh):
    lines = ["solid made_here"]
    for corners in mesh.triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid made_here"]).encode()


def binary_stl(mesh):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in mesh.triangles)
    return b"\0" * 80 + struct.pack("<I", len(mesh.triangles)) + rows


FORMATS = {
    "ascii.stl": ascii_stl,
    "binary.stl": binary_stl,
    "shape.obj": lambda mesh: mesh.export(file_type="obj").encode(),
    "shape.ply": lambda mesh: mesh.export(file_type="ply"),
    "shape.glb": lambda mesh: mesh.export(file_type="glb"),
}


def mesh_at(path, scale=(1.0, 1.0, 1.0)):
    return Mesh(path.name, path, scale, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", [*FORMATS, "shape.dae"])
def test_every_mesh_format_gives_same_triangles(name, tmp_path):
    mesh, path = link_like("bar"), tmp_path / name
    if name == "shape.dae":
        path.write_bytes(mesh.export(file_type="dae"))
    else:
        path.write_bytes(FORMATS[name](mesh))
    found = mesh_triangles("upper", mesh_at(path))
    assert len(found) == len(mesh.triangles)
    np.testing.assert_allclose(found.min(axis=(0, 1)), mesh.bounds[0], atol=1e-6)
    np.testing.assert_allclose(found.max(axis=(0, 1)), mesh.bounds[1], atol=1e-6)


@pytest.mark.parametrize(("unit", "metre"), [("0.001", 0.001), ("1", 1.0), ("0", 1.0), ("x", 1.0)])
def test_collada_mesh_is_scaled_by_its_unit(tmp_path, unit, metre):
    path = tmp_path / "shape.dae"
    text = link_like("bar").export(file_type="dae").decode()
    assert "<created>" in text
    path.write_text(text.replace("<created>", f'<unit name="u" meter="{unit}"/><created>', 1))
    try:
        found = mesh_triangles("upper", mesh_at(path))
    except FileFormatError:
        assert unit == "x"  # its reader refuses it
        return
    np.testing.assert_allclose(np.ptp(found, axis=(0, 1)), metre * np.array((0.12, 0.03, 0.02)))


def test_gltf_reads_its_buffers_from_its_folder_only(tmp_path):
    files = trimesh.exchange.gltf.export_gltf(link_like("bar").scene())
    (tmp_path / "in").mkdir()
    for name, data in files.items():
        (tmp_path / "in" / ("shape.gltf" if name.endswith(".gltf") else name)).write_bytes(data)
    path = tmp_path / "in" / "shape.gltf"
    assert len(mesh_triangles("upper", mesh_at(path)))
    buffer = next((tmp_path / "in").glob("*.bin"))
    buffer.rename(tmp_path / buffer.name)
    tree = json.loads(path.read_text())
    for entry in tree["buffers"]:
        if entry["uri"] == buffer.name:
            entry["uri"] = f"../{buffer.name}"
    path.write_text(json.dumps(tree))
    with pytest.raises(FileFormatError, match="mesh of link upper"):
        mesh_triangles("upper", mesh_at(path))


def test_mesh_is_scaled_as_description_says(tmp_path):
    path = tmp_path / "bar.stl"
    millimetres = link_like("bar")
    millimetres.apply_scale(1000.0)
    path.write_bytes(binary_stl(millimetres))
    found = mesh_triangles("a", mesh_at(path, (0.001,) * 3))
    np.testing.assert_allclose(np.ptp(found, axis=(0, 1)), (0.12, 0.03, 0.02), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "data", "found"),
    [
        ("empty.stl", b"", "cannot be read|no triangles"),
        ("text.stl", b"no mesh at all", "cannot be read|no triangles"),
        ("cut.glb", b"glTF\x02\0\0\0", "cannot be read"),
        ("shape.step", b"ISO-10303-21;", "its format is .step"),
    ],
)
def test_unreadable_mesh_error_names_link(name, data, found, tmp_path):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=f"mesh of link forearm: .*({found})"):
        mesh_triangles("forearm", mesh_at(path))


def test_missing_mesh_error_names_link(tmp_path):
    with pytest.raises(FileFormatError, match="mesh of link forearm: the file does not exist"):
        mesh_triangles("forearm", mesh_at(tmp_path / "gone.stl"))


def test_mesh_outside_folder_error_names_link():
    mesh = Mesh("/etc/passwd", None, (1.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    with pytest.raises(FileFormatError, match="mesh of link forearm: it is outside the model's"):
        mesh_triangles("forearm", mesh)


def test_mesh_without_trimesh_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "bar.stl"
    path.write_bytes(binary_stl(link_like("bar")))
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(InputError, match="needs trimesh") as caught:
        mesh_triangles("forearm", mesh_at(path))
    assert "[import]" in caught.value.hint


def test_mesh_file_above_size_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "_MAX_BYTES", 1000)
    path = tmp_path / "ball.stl"
    path.write_bytes(binary_stl(link_like("ball")))
    with pytest.raises(FileFormatError, match="larger than"):
        mesh_triangles("forearm", mesh_at(path))


@pytest.mark.parametrize("inside", ["meshes/bar.stl", "small_description/meshes/bar.stl"])
def test_mesh_is_found_by_package_relative_or_file_name(inside, tmp_path):
    (tmp_path / inside).parent.mkdir(parents=True)
    (tmp_path / inside).write_bytes(b"")
    (tmp_path / "urdf").mkdir()
    urdf = tmp_path / "urdf" / "arm.urdf"
    shape = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
    for name in ("package://small_description/meshes/bar.stl", f"../{inside}",
                 f"file://{tmp_path.as_posix()}/{inside}"):  # fmt: skip
        urdf.write_text(f'<robot name="a"><link name="base">{shape.format(name)}</link></robot>')
        (mesh,) = read_urdf(urdf, tmp_path).link("base").visuals
        assert mesh.path == (tmp_path / inside).resolve(), name


def test_collision_body_of_arm_without_shapes_is_refused(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        """<robot name="bare"><link name="base"/><link name="bar"/>
        <joint name="j" type="revolute"><parent link="base"/><child link="bar"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    with pytest.raises(InputError, match="no link of bare has a shape"):
        collision_body(ikservo.load_model(tmp_path / "arm.urdf", tip="bar"))

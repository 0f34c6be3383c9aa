"""Meshes of a description become capsules that contain them; what cannot be used is named."""

import json
import struct

import numpy as np
import pytest
import trimesh

import ikservo
from ikservo.errors import FileFormatError, InputError
from ikservo.kinematics.capsules import segment_distance
from ikservo.model import meshes
from ikservo.model.collision_model import bounding_capsules, collision_body
from ikservo.model.meshes import fit_capsules
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Mesh


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def link_like(kind):
    """Return a closed mesh such as links of arms have [m]."""
    if kind == "bar":
        return trimesh.creation.box((0.12, 0.03, 0.02))
    if kind == "plate":
        return trimesh.creation.box((0.10, 0.09, 0.006))
    if kind == "bracket":
        foot = trimesh.creation.box((0.02, 0.04, 0.10))
        arm = trimesh.creation.box((0.10, 0.04, 0.02))
        arm.apply_translation((0.06, 0.0, 0.04))
        return trimesh.util.concatenate([foot, arm])
    if kind == "tube":
        return trimesh.creation.annulus(0.020, 0.025, 0.08)
    if kind == "ball":
        return trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    body = trimesh.creation.capsule(height=0.1, radius=0.02)
    body.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    return body


# How far capsules stick out of each: no more than half its width, as those around boxes do.
STICK_OUT_M = {"bar": 0.015, "plate": 0.008, "bracket": 0.028, "tube": 0.026, "ball": 0.001,
               "slanted capsule": 0.001}  # fmt: skip
KINDS = list(STICK_OUT_M)


def outside_m(points, fits):
    """Return by how much the point that lies furthest outside all capsules does so."""
    distances = [
        segment_distance(points, points, np.broadcast_to(f.start_m, points.shape),
                         np.broadcast_to(f.end_m, points.shape)) - f.radius_m
        for f in fits
    ]  # fmt: skip
    return float(np.min(distances, axis=0).max())


@pytest.mark.parametrize("kind", KINDS)
def test_capsules_contain_the_surface_and_the_inside(kind):
    mesh = link_like(kind)
    fits = fit_capsules(np.array(mesh.triangles))
    points, _ = trimesh.sample.sample_surface(mesh, 3000, seed=1)
    assert outside_m(np.array(points), fits) <= 1e-9


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["bar", "plate", "ball", "slanted capsule"])
def test_capsules_contain_the_inside(kind):
    mesh = link_like(kind)
    points = np.random.default_rng(2).uniform(*mesh.bounds, (3000, 3))
    depths = points[:, None] - mesh.triangles[None, :, 0]
    inside = (np.einsum("pfk,fk->pf", depths, mesh.face_normals) <= 0.0).all(axis=1)
    assert inside.sum() > 300
    assert outside_m(points[inside], fit_capsules(np.array(mesh.triangles))) <= 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_capsules_stick_out_little(kind):
    mesh = link_like(kind)
    fits = fit_capsules(np.array(mesh.triangles))
    ratio = sum(f.volume_m3 for f in fits) / mesh.convex_hull.volume
    random, out = np.random.default_rng(3), []
    for f in fits:
        directions = random.normal(size=(200, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        ends = np.where(random.random((200, 1)) < 0.5, f.start_m, f.end_m)
        points = ends + f.radius_m * directions
        n, at = mesh.convex_hull.face_normals, mesh.convex_hull.triangles[:, 0]
        out.append(np.einsum("pfk,fk->pf", points[:, None] - at[None], n).max())
    print(f"{kind}: {len(fits)} capsules, {ratio:.2f} of the hull, {max(out) * 1e3:.1f} mm outside")  # noqa: T201
    assert len(fits) <= 8
    assert max(out) < STICK_OUT_M[kind]


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


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_capsules(name, tmp_path):
    mesh, path = link_like("bar"), tmp_path / name
    path.write_bytes(FORMATS[name](mesh))
    found = bounding_capsules("upper", mesh_at(path))
    expected = fit_capsules(np.array(mesh.triangles))
    assert {c.link for c in found} == {"upper"}
    assert len(found) == len(expected)
    assert sum(c.radius_m for c in found) == pytest.approx(sum(f.radius_m for f in expected), 1e-4)


def test_gltf_reads_its_buffers_from_its_folder_only(tmp_path):
    files = trimesh.exchange.gltf.export_gltf(link_like("bar").scene())
    (tmp_path / "in").mkdir()
    for name, data in files.items():
        (tmp_path / "in" / ("shape.gltf" if name.endswith(".gltf") else name)).write_bytes(data)
    path = tmp_path / "in" / "shape.gltf"
    assert bounding_capsules("upper", mesh_at(path))
    buffer = next((tmp_path / "in").glob("*.bin"))
    buffer.rename(tmp_path / buffer.name)
    tree = json.loads(path.read_text())
    for entry in tree["buffers"]:
        if entry["uri"] == buffer.name:
            entry["uri"] = f"../{buffer.name}"
    path.write_text(json.dumps(tree))
    with pytest.raises(FileFormatError, match="mesh of link upper"):
        bounding_capsules("upper", mesh_at(path))


def test_the_scale_is_that_of_the_description(tmp_path):
    path = tmp_path / "bar.stl"
    millimetres = link_like("bar")
    millimetres.apply_scale(1000.0)
    path.write_bytes(binary_stl(millimetres))
    found = bounding_capsules("a", mesh_at(path, (0.001,) * 3))
    assert max(capsule.radius_m for capsule in found) < 0.03


def test_a_second_look_reads_what_was_kept(tmp_path, monkeypatch):
    path = tmp_path / "bar.stl"
    path.write_bytes(binary_stl(link_like("bar")))
    first = bounding_capsules("a", mesh_at(path))
    monkeypatch.setattr("ikservo.model.meshes.read_triangles", None)
    path.touch()  # another time of change: memory forgets, the file does not
    again = bounding_capsules("a", mesh_at(path))
    np.testing.assert_allclose([c.radius_m for c in again], [c.radius_m for c in first])


def test_a_changed_mesh_is_fitted_anew(tmp_path):
    path = tmp_path / "bar.stl"
    path.write_bytes(binary_stl(link_like("bar")))
    before = bounding_capsules("a", mesh_at(path))
    path.write_bytes(binary_stl(link_like("ball")))
    assert len(bounding_capsules("a", mesh_at(path))) != len(before)


@pytest.mark.parametrize(
    ("name", "data", "found"),
    [
        ("empty.stl", b"", "cannot be read|no triangles"),
        ("text.stl", b"no mesh at all", "cannot be read|no triangles"),
        ("cut.glb", b"glTF\x02\0\0\0", "cannot be read"),
        ("shape.step", b"ISO-10303-21;", "its format is .step"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_an_error_that_names_the_link(name, data, found, tmp_path):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=f"mesh of link forearm: .*({found})"):
        bounding_capsules("forearm", mesh_at(path))


def test_a_missing_mesh_is_an_error_that_names_the_link(tmp_path):
    with pytest.raises(FileFormatError, match="mesh of link forearm: the file does not exist"):
        bounding_capsules("forearm", mesh_at(tmp_path / "gone.stl"))


def test_a_mesh_outside_is_an_error_that_names_the_link():
    mesh = Mesh("/etc/passwd", None, (1.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    with pytest.raises(FileFormatError, match="mesh of link forearm: it is outside the model's"):
        bounding_capsules("forearm", mesh)


def test_without_trimesh_the_error_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "bar.stl"
    path.write_bytes(binary_stl(link_like("bar")))
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(InputError, match="needs trimesh") as caught:
        bounding_capsules("forearm", mesh_at(path))
    assert "ikservo[mesh]" in caught.value.hint


def test_a_mesh_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "_MAX_BYTES", 1000)
    path = tmp_path / "ball.stl"
    path.write_bytes(binary_stl(link_like("ball")))
    with pytest.raises(FileFormatError, match="larger than"):
        bounding_capsules("forearm", mesh_at(path))


def test_splitting_leaves_no_gap_at_the_cut():
    mesh = link_like("bracket")
    triangles = np.array(mesh.triangles)
    above, below = meshes._cut_by_plane(triangles, np.array([1.0, 0.0, 0.0]), 0.013)
    areas = [trimesh.triangles.area(t).sum() for t in (triangles, above, below)]
    assert areas[0] == pytest.approx(areas[1] + areas[2])


def test_a_link_without_collision_shapes_is_covered_by_what_is_drawn(tmp_path):
    (tmp_path / "bar.stl").write_bytes(binary_stl(link_like("bar")))
    (tmp_path / "arm.urdf").write_text(
        """<robot name="bar"><link name="base"/><link name="bar"><visual><geometry>
        <mesh filename="package://any/bar.stl"/></geometry></visual></link>
        <joint name="j" type="revolute"><parent link="base"/><child link="bar"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    model = ikservo.load_model(tmp_path / "arm.urdf", tip="bar")
    assert float(collision_body(model).floor_distances([[0.0]], -1.0).gap_m.min()) == pytest.approx(
        0.98, abs=0.01
    )


@pytest.mark.parametrize("inside", ["meshes/bar.stl", "small_description/meshes/bar.stl"])
def test_package_names_are_looked_for_in_the_models_folder(inside, tmp_path):
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


def test_an_arm_without_any_shape_says_so(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        """<robot name="bare"><link name="base"/><link name="bar"/>
        <joint name="j" type="revolute"><parent link="base"/><child link="bar"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    with pytest.raises(InputError, match="no link of bare has a shape"):
        collision_body(ikservo.load_model(tmp_path / "arm.urdf", tip="bar"))

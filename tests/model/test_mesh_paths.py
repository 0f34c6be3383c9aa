"""Meshes are read only from the URDF's own folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Mesh, Urdf

OUTSIDE = [
    "/etc/passwd",
    "//etc/passwd",
    "../base.stl",
    "../../../../etc/passwd",
    "meshes/../../base.stl",
    "meshes/../base.stl",
    "./../base.stl",
    "..",
    ".",
    "",
    "package://small/meshes/../../base.stl",
    "package:///meshes/base.stl",
    "file:base.stl",
    "file://host/base.stl",
    "package://../../etc/passwd",
    "package://small/../../etc/passwd",
    "model://small/base.stl",
    "file:///etc/passwd",
    "http://127.0.0.1/base.stl",
    "\\\\server\\share\\base.stl",
    "..\\base.stl",
    "C:\\base.stl",
    "C:base.stl",
    "a" * 5000,
]


def read_with_mesh(urdf_path: Path, urdf_text: str, filename: str) -> Urdf:
    urdf_path.write_text(urdf_text.replace("meshes/base.stl", filename))
    return read_urdf(urdf_path)


def mesh_of(urdf: Urdf) -> Mesh:
    (mesh,) = urdf.link("base").visuals
    assert isinstance(mesh, Mesh)
    return mesh


@pytest.mark.parametrize("filename", OUTSIDE)
def test_mesh_outside_arm_folder_has_no_path(
    urdf_path: Path, urdf_text: str, filename: str
) -> None:
    assert mesh_of(read_with_mesh(urdf_path, urdf_text, filename)).path is None


def test_mesh_outside_arm_folder_gives_warning(urdf_path: Path, urdf_text: str) -> None:
    urdf = read_with_mesh(urdf_path, urdf_text, "../base.stl")
    assert urdf.warnings == (
        'meshes outside the model\'s folder cannot be used: 1 in all, the first is "../base.stl"',
    )


@pytest.mark.parametrize(
    "filename", ["base.stl", "./base.stl", "a/b/c.dae", "..base.stl", "a b.stl"]
)
def test_mesh_inside_arm_folder_has_its_path(
    urdf_path: Path, urdf_text: str, filename: str
) -> None:
    mesh = mesh_of(read_with_mesh(urdf_path, urdf_text, filename))
    assert mesh.path == urdf_path.parent.resolve() / filename


def test_mesh_symlink_out_of_arm_folder_is_not_followed(
    urdf_path: Path, urdf_text: str, tmp_path: Path
) -> None:
    (tmp_path / "secret.stl").write_text("solid")
    (urdf_path.parent / "base.stl").symlink_to(tmp_path / "secret.stl")
    assert mesh_of(read_with_mesh(urdf_path, urdf_text, "base.stl")).path is None


def test_folder_symlink_out_of_arm_folder_is_not_followed(
    urdf_path: Path, urdf_text: str, tmp_path: Path
) -> None:
    (urdf_path.parent / "meshes").symlink_to(tmp_path)
    assert mesh_of(read_with_mesh(urdf_path, urdf_text, "meshes/base.stl")).path is None


def test_circular_mesh_symlinks_do_not_cause_error(urdf_path: Path, urdf_text: str) -> None:
    (urdf_path.parent / "a").symlink_to("b")
    (urdf_path.parent / "b").symlink_to("a")
    assert read_with_mesh(urdf_path, urdf_text, "a/base.stl").root == "base"


def test_arm_opened_through_symlink_keeps_its_meshes(
    urdf_path: Path, urdf_text: str, tmp_path: Path
) -> None:
    (tmp_path / "alias").symlink_to(urdf_path.parent)
    urdf = read_with_mesh(tmp_path / "alias" / "arm.urdf", urdf_text, "base.stl")
    assert mesh_of(urdf).path == urdf_path.parent.resolve() / "base.stl"


def test_loading_a_model_never_opens_mesh_files(urdf_path: Path, urdf_text: str) -> None:
    os.mkfifo(urdf_path.parent / "base.stl")  # opening it would wait forever
    assert read_with_mesh(urdf_path, urdf_text, "base.stl").root == "base"

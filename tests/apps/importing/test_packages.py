"""Packages are found where the user says or in parent folders; nothing else is used."""

from pathlib import Path

import pytest

from ikservo.apps.importing.packages import PackageFolders
from ikservo.errors import FileFormatError


@pytest.fixture
def urdf(tmp_path):
    """Return a description in ``repo/arm_description/urdf`` beside the package ``other``."""
    package = tmp_path / "repo" / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "meshes" / "a.stl").write_text("x")
    (package / "package.xml").write_text("<package><name>arm_description</name></package>")
    (tmp_path / "repo" / "other").mkdir()
    (tmp_path / "repo" / "other" / "b.stl").write_text("x")
    (tmp_path / "repo" / ".git").mkdir()
    (tmp_path / "secret.stl").write_text("x")
    path = package / "urdf" / "arm.urdf"
    path.write_text("<robot/>")
    return path


@pytest.mark.parametrize(
    "name",
    [
        "package://arm_description/meshes/a.stl",
        "$(find arm_description)/meshes/a.stl",
        "../meshes/a.stl",
        "package://another_name/meshes/a.stl",
        "package://other/b.stl",
    ],
)
def test_mesh_is_found_by_package_or_relative_name(urdf, name):
    found = PackageFolders(urdf).find_mesh(name)
    assert found is not None
    assert found.is_file()


@pytest.mark.parametrize("start", ["file://", "file:///", ""])
def test_mesh_is_found_by_absolute_path_in_package(urdf, start):
    mesh = urdf.parents[1] / "meshes" / "a.stl"
    assert PackageFolders(urdf).find_mesh(f"{start}{mesh.as_posix()}") == mesh


def test_ros_package_is_found_by_name_in_its_manifest(urdf):
    package = urdf.parents[1].rename(urdf.parents[2] / "cloned")
    path = package / "urdf" / "arm.urdf"
    assert PackageFolders(path).find("arm_description") == package


def test_ros_package_folder_given_by_user_is_used(urdf, tmp_path):
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "c.stl").write_text("x")
    packages = PackageFolders(urdf, {"far": tmp_path / "else"})
    assert packages.find_mesh("package://far/c.stl") == tmp_path / "else" / "c.stl"


@pytest.mark.parametrize(
    "name",
    [
        "../../../secret.stl",
        "package://arm_description/../../secret.stl",
        "package://../secret.stl",
        "package:///secret.stl",
        "file:///etc/passwd",
        "/etc/passwd",
        "http://example.org/a.stl",
    ],
)
def test_mesh_outside_ros_package_is_not_found(urdf, name):
    packages = PackageFolders(urdf)
    found = packages.find_mesh(name)
    assert found is None or found.is_relative_to(urdf.parents[1])


def test_symlink_out_of_ros_package_is_not_followed(urdf, tmp_path):
    (urdf.parents[1] / "meshes" / "out.stl").symlink_to(tmp_path / "secret.stl")
    assert PackageFolders(urdf).find_mesh("../meshes/out.stl") is None


def test_ros_package_search_ends_at_repository_root(urdf, tmp_path):
    (tmp_path / "beyond").mkdir()
    packages = PackageFolders(urdf)
    assert packages.find("beyond") is None
    with pytest.raises(FileFormatError, match='needs the package "beyond"') as caught:
        packages.require("beyond")
    assert "--package beyond=FOLDER" in caught.value.hint


@pytest.mark.parametrize("manifest", ["<package><name>x", "", "<!DOCTYPE a><name>../x</name>"])
def test_damaged_ros_manifest_is_ignored_in_package_search(urdf, manifest):
    (urdf.parents[1] / "package.xml").write_text(manifest)
    assert PackageFolders(urdf).find("x") is None
    assert PackageFolders(Path(urdf)).find("arm_description") == urdf.parents[1]

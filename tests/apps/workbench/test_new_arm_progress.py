"""Progress messages while capsules are fitted to the meshes of a new arm."""

from ikservo.apps.importing.new_arm import _mesh_progress
from ikservo.apps.importing.shapes import MeshStep


def test_mesh_fitting_progress_shows_remaining_time():
    assert _mesh_progress(MeshStep("a.stl", 0, 17), 0.1) == "mesh 1 of 17: a.stl"
    assert _mesh_progress(MeshStep("b.stl", 5, 17), 20.0) == "mesh 6 of 17, about 48 s left: b.stl"

"""Scene files: turned boxes, cylinders, balls and half-spaces around an arm."""

import numpy as np
import pytest

import ikservo
from ikservo.apps.page.panels.things_panel import thing_fields
from ikservo.errors import BadValueError, FileFormatError, RefusedError
from ikservo.kernels.capsule_distances import point_shape_distance
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model import load_model
from ikservo.model.scene_file import (
    PlacedArm,
    describe_thing,
    make_shape,
    read_scene,
    read_scene_with_arms,
    scene_text,
    turned_deg,
    with_scene,
)

SCENE = """
margin_m = 0.01
[[box]]
name = "the shelf"
centre_m = [0.5, 0.0, 0.2]
size_m = [0.4, 0.2, 0.02]
rpy_deg = [0, 0, 90]
[[cylinder]]
name = "the can"
centre_m = [0.0, 0.4, 0.1]
radius_m = 0.03
height_m = 0.2
axis = [1, 0, 0]
[[sphere]]
name = "the ball"
centre_m = [0.0, -0.4, 0.1]
radius_m = 0.05
[[half_space]]
name = "the wall"
point_m = [-0.5, 0.0, 0.0]
normal = [2, 0, 0]
"""

ARM = """
[[arm]]
name = "the second"
arm = "koch"
port = "/dev/ttyUSB1"
at_m = [0.45, 0, 0]
rpy_deg = [0, 0, 180]
"""


@pytest.fixture
def scene(tmp_path):
    def write(text=SCENE):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "point", "distance_m"),
    [
        ("the shelf", (0.5, 0.3, 0.2), 0.1),  # a long side along y, after a quarter turn
        ("the shelf", (0.7, 0.0, 0.2), 0.1),
        ("the can", (0.2, 0.4, 0.1), 0.1),
        ("the can", (0.0, 0.4, 0.2), 0.07),
        ("the ball", (0.0, -0.4, 0.4), 0.25),
        ("the wall", (0.3, 2.0, 1.0), 0.8),
    ],
)
def test_scene_objects_have_place_and_margin_of_scene_file(scene, name, point, distance_m):
    rows = {each.name: each.row for each in read_scene(scene())}
    found_m = point_shape_distance(*point, np.array([rows[name]]), 0)
    assert found_m == pytest.approx(distance_m - 0.01, abs=1e-12)


def test_scene_object_blocks_arm_and_is_drawn_on_page(scene):
    model = with_scene(load_model("so101"), scene())
    drawn = [fields for each in model.keep_out if (fields := thing_fields(each))["drawn"]]
    assert [each["name"] for each in drawn] == ["the shelf", "the can", "the ball"]
    assert [each["shape"] for each in drawn] == ["box", "cylinder", "sphere"]
    ball = '[[sphere]]\nname = "the ball"\ncentre_m = [0.25, 0.0, 0.15]\nradius_m = 0.03\n'
    model = with_scene(load_model("so101"), scene(ball))
    with (
        ikservo.open_arm(model, port="sim:?pose=home") as arm,
        pytest.raises(ikservo.errors.CollisionError, match="would touch the ball"),
    ):
        arm.move_to((0.25, 0.0, 0.15))


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[[ball]]\nname = 'x'\n", "ball"),
        (SCENE.replace("radius_m = 0.05", "radius_m = -1.0"), r"sphere\[0\].radius_m"),
        (SCENE.replace("[0.4, 0.2, 0.02]", "[0.4, 0.2]"), r"box\[0\].size_m"),
        (SCENE.replace("margin_m = 0.01", "margin_m = nan"), "margin_m"),
        ("box = 3", "box"),
        (ARM.replace("at_m", "centre_m"), r"arm\[0\].centre_m"),
        (ARM.replace("0.45", "inf"), r"arm\[0\].at_m"),
        (ARM * 2, "repeats"),
        (SCENE + ARM.replace("the second", "the ball"), "repeats"),
    ],
)
def test_malformed_scene_error_names_key(scene, text, where):
    with pytest.raises(FileFormatError, match=where):
        read_scene(scene(text))


def test_scene_direction_vector_of_zero_length_is_refused(scene):
    with pytest.raises(BadValueError, match="the wall"):
        read_scene(scene(SCENE.replace("[2, 0, 0]", "[0, 0, 0]")))


def test_half_space_does_not_depend_on_chosen_point_of_plane():
    (far,), (near,) = (
        [make_shape("half_space", "the wall", {"point_m": point, "normal": (0.0, -1.0, 0.0)})]
        for point in ((12.0, 0.1, -30.0), (0.0, 0.1, 0.0))
    )
    assert far.row == pytest.approx(near.row)


@pytest.mark.parametrize("name", ["crate", "the table", "forearm", "gripper_link"])
def test_duplicate_scene_name_is_refused(tmp_path, name):
    path, model = tmp_path / "scene.toml", load_model("so101")
    taken = name if name in ("crate", "the table") else model.chain.frames[-1]
    one = f'[[sphere]]\nname = "{taken}"\ncentre_m = [1.0, 0.0, 0.0]\nradius_m = 0.1\n'
    path.write_text(one * 2 if name == "crate" else one)
    with pytest.raises(FileFormatError, match="repeats"):
        with_scene(model, path)


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [
        ("sphere", {"centre_m": (0, 0, 0), "radius_m": 1e300}),
        ("sphere", {"centre_m": (1e300, 0, 0), "radius_m": 0.1}),
        ("box", {"centre_m": (0, 0, 0), "size_m": (1e300, 1, 1)}),
        ("cylinder", {"centre_m": (0, 0, 0), "radius_m": 1, "height_m": 1e300}),
        ("cylinder", {"centre_m": (0, 0, 0), "radius_m": 1, "height_m": 1, "axis": (0, 0, 1e300)}),
        ("half_space", {"point_m": (0, 0, -1e300), "normal": (0, 0, 1)}),
        ("half_space", {"point_m": (0, 0, 0), "normal": (0, 0, 1e300)}),
    ],
)
def test_oversized_or_distant_scene_object_is_refused(kind, sizes):
    with pytest.raises(FileFormatError, match="at most"):
        make_shape(kind, "the sun", sizes)


def test_written_scene_is_read_back_with_same_shapes(scene, tmp_path):
    things = read_scene(scene())
    (tmp_path / "again.toml").write_text(scene_text(things), encoding="utf-8")
    for thing, again in zip(things, read_scene(tmp_path / "again.toml"), strict=True):
        assert again.name == thing.name
        for point in np.random.default_rng(1).uniform(-0.6, 0.6, (40, 3)):
            far_m = point_shape_distance(*point, thing.row[None], 0)
            again_m = point_shape_distance(*point, again.row[None], 0)
            assert again_m <= max(far_m, 0.0) + 1e-6  # edges are not round any more
            assert again_m >= far_m - 0.01


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere", "half_space"])
def test_scene_object_description_has_its_original_sizes(scene, kind):
    no_margin = SCENE.replace("margin_m = 0.01", "")
    thing = {"box": 0, "cylinder": 1, "sphere": 2, "half_space": 3}[kind]
    found, sizes = describe_thing(read_scene(scene(no_margin))[thing])
    assert found == kind
    row = make_shape(kind, "again", sizes).row
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (40, 3))
    for point in points:
        far_m = point_shape_distance(*point, read_scene(scene(no_margin))[thing].row[None], 0)
        assert point_shape_distance(*point, row[None], 0) == pytest.approx(far_m, abs=1e-9)


def test_second_arm_of_scene_file_is_read_and_required_open(scene, tmp_path):
    path = scene(SCENE + ARM)
    things, arms = read_scene_with_arms(path)
    assert arms == (
        PlacedArm("the second", (0.45, 0.0, 0.0), (0.0, 0.0, 180.0), "koch", "/dev/ttyUSB1"),
    )
    (tmp_path / "again.toml").write_text(scene_text(things, arms), encoding="utf-8")
    assert read_scene_with_arms(tmp_path / "again.toml")[1] == arms
    for read in (read_scene, lambda path: with_scene(load_model("so101"), path)):
        with pytest.raises(RefusedError, match="the second, which is not open in this program"):
            read(path)


@pytest.mark.parametrize("at_m", [(0.0, 0.0, 0.01), (0.0, 500.0, 0.0)])
def test_second_arm_at_same_place_or_off_table_is_refused(scene, at_m):
    with pytest.raises(FileFormatError, match="at_m of the second"):
        read_scene_with_arms(scene(f'[[arm]]\nname = "the second"\nat_m = {list(at_m)}\n'))


def test_euler_angles_of_downward_object_match_its_rotation():
    R = rotation_rpy(*np.radians([10.0, 90.0, 20.0]))
    again = rotation_rpy(*np.radians(turned_deg(R)))
    np.testing.assert_allclose(again, R, atol=1e-9)

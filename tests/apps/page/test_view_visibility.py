"""Links that are visible or hidden from a point, and the links that hide them (lecture L18)."""

from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.page.picking import visibility
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.raycast import cast_rays, link_shapes
from ikservo.apps.page.picking.visibility import TABLE, VisibilityChecker
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.model.arm_model import KeepOutBox
from ikservo.model.collision_capsules import capsules_of
from tests.apps.page.view_fixtures import looked_at, model_of, stage
from tests.apps.page.view_session import ViewSession

HOME = model_of("so101").pose("home")


def seen(eye_m, model=None, joints=HOME):
    found = ikservo.visible_from(model or model_of("so101"), joints, eye_m)
    return {each.link: each for each in found}


@pytest.mark.parametrize("view", ["side", "top", "front", "orbit"])
@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_visible_fraction_matches_rays_through_all_pixels(name, view):
    """The fraction of a link's pixels at which it is still visible among the others."""
    model, home = model_of(name), stage(name).home
    poses, camera = link_poses(model.chain, home, {}), looked_at(name, view)
    grid = np.stack(np.meshgrid(np.arange(0, 800, 2.5), np.arange(0, 600, 2.5)), -1).reshape(-1, 2)
    ways = cast_rays(link_shapes(capsules_of(model)), poses, *camera.rays(grid))
    first = np.argmin(ways, axis=1)
    floating = replace(model, floor_m=None)
    for i, each in enumerate(VisibilityChecker(floating).from_camera(poses, camera)):
        alone = np.isfinite(ways[:, i])
        if alone.sum() > 200:
            assert each.visible_fraction == pytest.approx(
                (alone & (first == i)).sum() / alone.sum(), abs=0.06
            )


def test_visibility_from_far_point_equals_parallel_projection():
    model, home = replace(model_of("so101"), floor_m=None), stage("so101").home
    poses, camera = link_poses(model.chain, home, {}), looked_at("so101", "front")
    one, far = VisibilityChecker(model), camera.eye_m - 200.0 * camera.forward
    for a, b in zip(one.from_camera(poses, camera), one.from_point(poses, far), strict=True):
        assert a.visible_fraction == pytest.approx(b.visible_fraction, abs=0.03)


def test_wall_in_front_of_camera_hides_every_link():
    wall = KeepOutBox("the wall", (0.5, -2.0, -1.0), (0.52, 2.0, 3.0))
    found = seen((0.8, 0.0, 0.3), replace(model_of("so101"), keep_out=(wall,)))
    assert {each.hidden_by for each in found.values()} == {("the wall",)}
    assert not any(each.is_visible for each in found.values())


def test_shoulder_seen_from_front_is_hidden_by_gripper():
    found = seen((0.6, 0.0, 0.1))
    assert found["shoulder"].visible_fraction < 0.2
    assert "gripper" in found["shoulder"].hidden_by
    assert found["gripper"].is_visible


def test_gripper_is_hidden_by_the_arm_seen_from_behind():
    assert not seen((-0.5, 0.0, 0.1))["gripper"].is_visible


def test_table_hides_every_link_from_below():
    assert {each.hidden_by for each in seen((0.2, 0.0, -0.5)).values()} == {(TABLE,)}


def test_visibility_of_jaw_depends_on_its_opening():
    eye = (0.6, -0.3, 0.2)
    closed, opened = (
        seen(eye, joints={**HOME, "gripper": at})["jaw"].visible_fraction for at in (0.0, 1.5)
    )
    assert abs(opened - closed) > 0.02


def test_error_names_joint_missing_in_visibility_request():
    with pytest.raises(UnknownNameError, match="elbow_flex"):
        seen((1, 1, 1), joints={k: v for k, v in HOME.items() if k != "elbow_flex"})


@pytest.mark.parametrize("eye", [(0.0, 0.0), (0.0, np.nan, 0.0), "camera"])
def test_invalid_viewpoint_is_refused(eye):
    with pytest.raises(BadValueError):
        seen(eye)


@pytest.mark.full
def test_page_computes_manipulability_three_times_per_second(monkeypatch):
    with ViewSession() as session:
        computed = []
        plain = visibility.conditioning
        monkeypatch.setattr(
            visibility, "conditioning", lambda *arm: computed.append(1) or plain(*arm)
        )
        session.controller.frames(session.client)
        computed.clear()
        for _ in range(100):  # ten seconds
            session.clock.sleep_until(session.clock.now_s() + 0.1)
            session.controller.frames(session.client)
    assert 25 <= len(computed) <= 35

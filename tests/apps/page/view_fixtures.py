"""Arms and cameras for the tests of the view."""

from __future__ import annotations

from functools import cache

import numpy as np
from hypothesis import strategies as st

from ikservo.apps.page.dragging.drag import Drag
from ikservo.apps.page.drawing.scene_graph import SceneGraph
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.picking import Picker, PointerContext
from ikservo.apps.page.picking.projection import Camera, Viewport, view_rotation
from ikservo.apps.page.picking.raycast import link_shapes
from ikservo.apps.page.picking.viewpoints import Viewpoint, arm_extent, make_camera
from ikservo.model import load_model
from ikservo.model.collision_capsules import capsules_of

VIEWPORT = Viewport(800.0, 600.0)

_unit = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
directions = _unit.filter(lambda v: float(v @ v) > 0.01)
points = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)
viewports = st.builds(
    Viewport, st.floats(200, 4000), st.floats(200, 4000), st.sampled_from([1.0, 1.5, 2.0, 3.0])
)


def _upwards(forward, helper):
    return helper if np.linalg.norm(np.cross(forward, helper)) > 0.05 else helper[[1, 2, 0]]


cameras = st.builds(
    lambda viewport, eye, forward, helper, scale, perspective: Camera(
        viewport, eye, view_rotation(forward, _upwards(forward, helper)), scale, perspective
    ),
    viewports,
    points,
    directions,
    st.sampled_from(list(np.eye(3))),
    st.floats(50, 5000),
    st.booleans(),
)


@cache
def model_of(name):
    return load_model(name)


@cache
def stage(name):
    return arm_extent(model_of(name))


def graph_of(model, chain=None):
    """Return the scene graph of an arm, inside a chain's limits if one is given."""
    return SceneGraph(model, model.chain if chain is None else chain, arm_extent(model))


@cache
def picker(name):
    return Picker(link_shapes(capsules_of(model_of(name))))


def selected(hits):
    """Return the nearest hit right under the pointer, else the nearest beside it, else None."""
    return min(hits, key=lambda hit: (hit.away_px > 0.0, hit.depth_m), default=None)


def looked_at(name, view, q=None, viewport=VIEWPORT):
    """Return the camera of a view of an arm at joints q; at home if None."""
    the_stage = stage(name)
    yaw_rad = the_stage.yaw_rad(the_stage.home if q is None else q)
    return make_camera(the_stage, Viewpoint(view), viewport, yaw_rad)


def sight(name, view, q=None):
    q = stage(name).home if q is None else q
    return PointerContext(looked_at(name, view, q), (q,))


def drag_of(name):
    return Drag(model_of(name).chain, picker(name))


def pixel_of(name, view, q, link, offset_m=(0.0, 0.0, 0.0)):
    """Return the pixel of a point of a link."""
    T = model_of(name).chain.forward(q, link, offset_m)
    return looked_at(name, view, q).project(T[:3, 3])[0]


def pixel_on(name, view_state, link):
    """Return a pixel at which a link of the arm can be seen."""
    poses = link_poses(model_of(name).chain, view_state.arms[0], view_state.other_joints)
    for capsule in capsules_of(model_of(name)):
        if capsule.link == link:
            px, _ = view_state.camera.project(sum(capsule.ends(poses[link])) / 2)
            hit = selected(picker(name).pick_all_at(view_state.camera, poses, px, 1))
            if hit is not None and hit.link == link:
                return px
    raise AssertionError(f"{link} is hidden")

"""Compiled ray casting and picking are those of the Python code, bit for bit."""

import numpy as np
import pytest

from ikservo.apps.page.picking import pick_region, raycast
from ikservo.apps.page.picking.bvh import LEFT, build_bvh
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.picking import Picker
from ikservo.kernels.compiled import uncompiled
from tests.apps.page.test_view_pick import VIEWS, cloud, places, rays_at
from tests.apps.page.view_fixtures import looked_at, model_of, picker
from tests.both_ways import needs_extension, run_both_ways


@needs_extension
@pytest.mark.parametrize("kind", ["capsules", "balls", "triangles"])
def test_rays_meet_the_same_shapes_both_ways(monkeypatch, kind):
    calls = run_both_ways(monkeypatch, raycast, "raycast")
    random = np.random.default_rng(1)
    shapes = {link: cloud(random, 60, kind) for link in ("a", "b")}
    Picker(shapes).cast(*rays_at(random, 20), places(random, shapes))
    assert len(calls) == 1


@needs_extension
def test_looking_at_every_shape_is_the_same_both_ways(monkeypatch):
    calls = run_both_ways(monkeypatch, raycast, "raycast_brute_force")
    random = np.random.default_rng(2)
    rows, (origins, directions) = cloud(random, 50, "capsules"), rays_at(random, 10)
    for origin, direction in zip(origins, directions, strict=True):
        raycast.raycast_brute_force(origin, direction, rows, np.empty(2))
    assert len(calls) == 10


@needs_extension
@pytest.mark.parametrize("view", VIEWS)
def test_squares_of_pixels_hold_the_same_links_both_ways(monkeypatch, view):
    calls = run_both_ways(monkeypatch, pick_region, "find_in_square")
    model = model_of("so101")
    camera = looked_at("so101", view)
    poses = link_poses(model.chain, model.chain.mid_range(), {})
    random = np.random.default_rng(3)
    size = (800.0, 600.0)
    for px in random.uniform(0.2, 0.8, (15, 2)) * size:
        picker("so101").pick_all_at(camera, poses, px, 40.0)
    assert len(calls) == 15


@pytest.mark.parametrize("way", ["compiled", "uncompiled"])
def test_a_tree_whose_children_do_not_exist_or_come_before_is_not_followed(way):
    run = uncompiled["raycast"] if way == "uncompiled" else raycast.raycast
    random = np.random.default_rng(4)
    forest = build_bvh({"a": cloud(random, 50, "balls")})
    origins, directions = rays_at(random, 5)
    around = np.array([[-9.0, -9.0, -9.0, 9.0, 9.0, 9.0]])
    for child in (-1, 0, 10**6, 2**62):
        nodes = forest.nodes.copy()
        nodes[0, LEFT] = child
        ways, hit = np.empty((5, 1)), np.empty((5, 1), np.int64)
        run(origins, directions, np.eye(3).reshape(1, 9), np.zeros((1, 3)), around, forest.roots,
            forest.boxes, nodes, forest.rows, ways, hit)  # fmt: skip
        assert np.isinf(ways[hit < 0]).all()

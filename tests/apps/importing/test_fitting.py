"""Capsules contain their mesh and fit it closely; judged by trimesh."""

import tracemalloc

import numpy as np
import pytest
import trimesh

from ikservo.apps.importing import mesh_capsules
from ikservo.apps.importing.mesh_capsules import MAX_CAPSULES, fit_capsules


def bracket():
    """Return a plate with two walls, 80 x 50 x 40 mm, 4 mm thick."""
    parts = [
        trimesh.creation.box((0.08, 0.05, 0.004)),
        trimesh.creation.box((0.08, 0.004, 0.04)).apply_translation((0.0, 0.023, 0.018)),
        trimesh.creation.box((0.08, 0.004, 0.04)).apply_translation((0.0, -0.023, 0.018)),
    ]
    return trimesh.util.concatenate(parts)


MESHES = {
    "a servo": trimesh.creation.box((0.045, 0.025, 0.035)),
    "a long rod": trimesh.creation.cylinder(0.005, 0.3),
    "a ball": trimesh.creation.icosphere(2, 0.04),
    "a plate": trimesh.creation.box((0.12, 0.08, 0.003)),
    "a ring": trimesh.creation.torus(0.06, 0.008),
    "a bent arm": trimesh.util.concatenate(
        [
            trimesh.creation.box((0.2, 0.03, 0.03)),
            trimesh.creation.box((0.03, 0.03, 0.15)).apply_translation((0.09, 0.0, 0.07)),
        ]
    ),
}


def union_points(capsules):
    """Return the points on the capsules' surfaces that no other capsule contains."""
    found = []
    for i, capsule in enumerate(capsules):
        length_m = float(np.linalg.norm(capsule.end_m - capsule.start_m))
        shape = trimesh.creation.capsule(length_m, capsule.radius_m, count=[24, 24])
        along = (capsule.end_m - capsule.start_m) / length_m if length_m else (0.0, 0.0, 1.0)
        points = shape.vertices - [0.0, 0.0, shape.bounds[:, 2].mean()]
        T = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), along)
        points = points @ T[:3, :3].T + 0.5 * (capsule.start_m + capsule.end_m)
        for k, other in enumerate(capsules):
            if k != i:
                points = points[other.depth_m(points) < 0.0]
        found.append(points)
    return np.concatenate(found)


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", [*MESHES, "a bracket"])
def test_fitted_capsules_contain_mesh_and_stay_close_to_it(name):
    mesh = MESHES.get(name) or bracket()
    fit = fit_capsules(np.array(mesh.triangles))
    inside = np.array([c.depth_m(mesh.sample(4000, seed=1)) for c in fit.capsules]).max(axis=0)
    assert inside.min() >= 0.0
    away_m = float(trimesh.proximity.closest_point_naive(mesh, union_points(fit.capsules))[1].max())
    assert away_m <= fit.excess_m + 0.0005
    assert len(fit.capsules) <= MAX_CAPSULES
    if name in MESHES:
        assert fit.excess_m <= fit.allowed_m


@pytest.mark.full
def test_mesh_of_simple_part_is_fitted_by_few_capsules():
    counts = {name: len(fit_capsules(np.array(m.triangles)).capsules) for name, m in MESHES.items()}
    assert counts["a long rod"] == 1
    assert counts["a ball"] == 1
    assert counts["a servo"] <= 2
    assert counts["a bent arm"] <= 4


def test_fitted_capsules_contain_interior_of_closed_mesh():
    mesh = trimesh.creation.box((0.3, 0.2, 0.1))
    fit = fit_capsules(np.array(mesh.triangles))
    points = (np.random.default_rng(3).random((3000, 3)) - 0.5) * mesh.extents
    assert np.array([c.depth_m(points) for c in fit.capsules]).max(axis=0).min() >= 0.0


@pytest.mark.parametrize("count", [1, 2])
def test_fitted_capsules_contain_flat_mesh(count):
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.05, 0.0], [0.0, 0.05, 0.0]])
    triangles = corners[[[0, 1, 2], [0, 2, 3]][:count]]
    fit = fit_capsules(triangles)
    inside = [c.depth_m(triangles.reshape(-1, 3)) for c in fit.capsules]
    assert np.max(inside, axis=0).min() >= -1e-12


@pytest.mark.full
def test_capsule_fit_of_bracket_uses_capsules_of_its_servo():
    sides = [trimesh.creation.box((0.09, 0.004, 0.05)).apply_translation((0.0, y, 0.025))
             for y in (-0.035, 0.035)]  # fmt: skip
    holder = trimesh.util.concatenate([trimesh.creation.box((0.09, 0.07, 0.004)), *sides])
    servo = trimesh.creation.box((0.088, 0.064, 0.046)).apply_translation((0.0, 0.0, 0.026))
    walls, body = np.array(holder.triangles), np.array(servo.triangles)
    first = fit_capsules(body, [walls])
    second = fit_capsules(walls, [body], first.capsules)
    capsules, both = first.capsules + second.capsules, trimesh.util.concatenate([servo, holder])
    inside = np.array([c.depth_m(both.sample(8000, seed=1)) for c in capsules]).max(axis=0)
    assert inside.min() >= 0.0
    away_m = trimesh.proximity.closest_point_naive(both, union_points(capsules))[1]
    assert away_m.max() <= max(first.excess_m, second.excess_m) + 0.0005
    assert second.excess_m < fit_capsules(walls).excess_m - 0.003


def test_mesh_inside_other_capsules_gets_no_capsule():
    block, core = (trimesh.creation.box((size, size, size)) for size in (0.05, 0.02))
    outer = fit_capsules(np.array(block.triangles))
    inner = fit_capsules(np.array(core.triangles), [np.array(block.triangles)], outer.capsules)
    assert inner.capsules == ()
    assert inner.excess_m == 0.0


def hostile_triangles(name):
    """Return few triangles that would still take unbounded time to fit."""
    rng = np.random.default_rng(4)
    if name == "large triangles":
        return rng.uniform(0.0, 0.3, (20_000, 3, 3))
    if name.startswith("loose"):
        count = 100_000 if name.endswith("100,000") else 30_000
        middles = rng.uniform(-0.1, 0.1, (count, 1, 3))
        return middles + rng.uniform(-0.03, 0.03, (count, 3, 3))
    if name == "one huge":
        return np.array([[[0.0, 0.0, 0.0], [900.0, 0.0, 0.0], [0.0, 900.0, 0.0]]])
    if name == "duplicated":
        return np.repeat(rng.uniform(0.0, 0.3, (10, 3, 3)), 10_000, axis=0)
    if name == "slivers":
        start, end = rng.uniform(0.0, 0.3, (2, 20_000, 3))
        return np.stack([start, end, end + 1e-7], axis=1)
    if name == "parallel plates":
        plates = np.tile([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0]], (20_000, 1, 1))
        plates[:, :, 2] = np.linspace(0.0, 0.3, len(plates))[:, None]
        return plates
    tiny = rng.uniform(0.0, 0.3, (20_000, 1, 3)) + rng.uniform(0.0, 1e-3, (20_000, 3, 3))
    tiny[0] = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]
    return tiny


@pytest.mark.sample(3)
@pytest.mark.full
@pytest.mark.parametrize(
    "name",
    [
        "large triangles", "slivers", "parallel plates", "one large and many tiny",
        "loose, 30,000", "loose, 100,000", "one huge", "duplicated",
    ],
)  # fmt: skip
def test_capsule_fit_of_hostile_mesh_has_bounded_work_and_memory(name, monkeypatch):
    triangles, cut = hostile_triangles(name), []
    halves, by_plane = mesh_capsules._halves, mesh_capsules._cut_by_plane
    monkeypatch.setattr(
        mesh_capsules, "_halves", lambda some: cut.append(len(some)) or halves(some)
    )
    monkeypatch.setattr(
        mesh_capsules,
        "_cut_by_plane",
        lambda some, *at: cut.append(len(some)) or by_plane(some, *at),
    )
    tracemalloc.start()
    fit = fit_capsules(triangles)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    inside = np.max([c.depth_m(triangles.reshape(-1, 3)) for c in fit.capsules], axis=0)
    assert inside.min() >= -1e-9
    assert peak < 300e6
    assert max(cut) < 500_000
    assert sum(cut) < 1_200_000


@pytest.mark.full
def test_capsule_fit_beside_large_triangles_has_bounded_memory():
    core = np.array(trimesh.creation.box((0.1, 0.1, 0.1)).triangles)
    others = hostile_triangles("large triangles")
    given = fit_capsules(core, [others]).capsules
    tracemalloc.start()
    assert len(fit_capsules(others, [core], given).capsules) <= MAX_CAPSULES
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 300e6

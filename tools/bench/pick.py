"""How much faster picking is through boxes than by testing every shape.

Usage: python tools/bench/pick.py

One ray is cast through trees of boxes and through a plain list, both compiled, for growing
numbers of random shapes; then a whole press of a pointer on arms of the catalogue.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from ikservo.kinematics.arrays import Matrix
from ikservo.model import load_model
from ikservo.model.collision_model import capsules_of
from ikservo.view.bvh import capsule_rows, link_primitives, triangle_rows
from ikservo.view.camera import Viewport
from ikservo.view.link_poses import link_poses
from ikservo.view.picking import Picker
from ikservo.view.raycast import raycast_brute_force
from ikservo.view.viewpoints import Viewpoint, arm_extent, make_camera

RAYS, RUNS = 200, 7
COUNTS = (10, 30, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000)
ARMS = ("so101", "open_manipulator_x", "vx300s")


def main() -> None:
    """Print one table for each kind of shape, and one for arms."""
    for kind in ("capsules", "triangles"):
        print(f"{kind:>10}  {'boxes':>9}  {'all':>10}  {'ratio':>6}  {'looked at':>9}")
        for count in COUNTS:
            print(_row(kind, count))
        print()
    print(f"{'arm':>20}  {'shapes':>6}  {'a press':>9}")
    for name in ARMS:
        print(_press(name))


def _row(kind: str, count: int) -> str:
    random = np.random.default_rng(count)
    rows = _cloud(random, count, kind)
    picker, nearest = Picker({"shapes": rows}), np.empty(2)
    origins, directions = _rays(random)

    def through_all() -> None:
        for origin, direction in zip(origins, directions, strict=True):
            raycast_brute_force(origin, direction, rows, nearest)

    boxes_s = _best_s(lambda: picker.cast(origins, directions, {"shapes": np.eye(4)})) / RAYS
    all_s = _best_s(through_all) / RAYS
    looked = picker.tested / RAYS
    return (
        f"{count:>10,}  {boxes_s * 1e6:>6.2f} µs  {all_s * 1e6:>7.2f} µs"
        f"  {all_s / boxes_s:>6.1f}  {looked:>9.1f}"
    )


def _press(name: str) -> str:
    model = load_model(name)
    stage, capsules = arm_extent(model), capsules_of(model)
    camera = make_camera(stage, Viewpoint("orbit"), Viewport(800, 600), 0.0)
    poses = link_poses(model.chain, stage.home, {})
    picker, px = Picker(link_primitives(capsules)), camera.project(poses["forearm"][:3, 3])[0]
    press_s = _best_s(lambda: picker.pick_at(camera, poses, px))
    return f"{name:>20}  {len(capsules):>6}  {press_s * 1e6:>6.1f} µs"


def _cloud(random: np.random.Generator, count: int, kind: str) -> Matrix:
    """Return random shapes in a box of two metres, the smaller the more there are."""
    size = 0.6 / count ** (1 / 3)
    middles = random.uniform(-1, 1, (count, 3))
    if kind == "triangles":
        return triangle_rows(middles[:, None] + size * random.normal(size=(count, 3, 3)))
    ends = middles + size * random.normal(size=(count, 3))
    return capsule_rows(middles, ends, size * random.uniform(0.1, 0.5, count))


def _rays(random: np.random.Generator) -> tuple[Matrix, Matrix]:
    origins = random.normal(size=(RAYS, 3))
    origins *= 4.0 / np.linalg.norm(origins, axis=1)[:, None]
    ways = random.uniform(-1, 1, (RAYS, 3)) - origins
    return origins, ways / np.linalg.norm(ways, axis=1)[:, None]


def _best_s(run: Callable[[], object]) -> float:
    run()  # compiles
    times: list[float] = []
    for _ in range(RUNS):
        began = time.thread_time()
        run()
        times.append(time.thread_time() - began)
    return min(times)


if __name__ == "__main__":
    main()

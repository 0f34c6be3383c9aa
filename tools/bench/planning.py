"""Measure path planning: problems solved, times, and whether other checkers find paths free.

    python tools/bench/planning.py panda FOLDER --urdf FILE     # MotionBenchMaker's problems
    python tools/bench/planning.py panda FOLDER --urdf FILE --by ikservo ompl sscbirrt  # in turn
    python tools/bench/planning.py arms                         # random scenes of four arms
    python tools/bench/planning.py arms --upright 10 --best-of 20
    python tools/bench/planning.py arms --by ompl               # asked for unsolved problems

FOLDER holds folders with request*.yaml and scene*.yaml. Every path is checked by Coal (through
Pinocchio) and by MuJoCo, at samples between which nothing moves by more than a millimetre. Coal
also judges the ends of problems that have no free end for ikservo.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import math
import random
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from planning_peers import find_by_ompl, find_by_sscbirrt

from ikservo.arm.opening import open_own_arm
from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker, KeepOutBox
from ikservo.guard.clear_space import ClearSpace
from ikservo.guard.path_search import WaySearch, path_length
from ikservo.kinematics import JointIndex
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.packed import PackedBody
from ikservo.kinematics.se3 import exp_so3
from ikservo.model import load_model
from ikservo.model.collision_capsules import capsules_of
from ikservo.planning import ways_around
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MoveJoints
from ikservo.planning.path_constraint import ConstrainedTool, PathConstraint
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PreflightPlanner

Array = NDArray[np.float64]

_SETTLED_MARGIN_M = 0.002
_STEP_M = 0.001
_MOST_S = 60.0  # time limit of other planners
_WALK_RAD = 0.1
_MOST = 1000000
_ROUNDED_RAD = 1e-5  # rounding, in files, of the limits of joints with a full turn
_ARMS = ("so101", "koch", "open_manipulator_x", "wx250s")


@dataclass
class Thing:
    """A box or a cylinder of a scene, as a row for the checker."""

    name: str
    row: Array


@dataclass
class Judged:
    """The result of one problem: the time, the path, and which checkers find it free."""

    seconds: float
    path: Array | None
    free: dict[str, bool]


def rotation(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation (3, 3) of a quaternion."""
    axis = np.array([x, y, z])
    sine = float(np.linalg.norm(axis))
    return exp_so3(axis / sine * 2.0 * np.arctan2(sine, w) if sine > 0.0 else axis)


def things_of(scene: dict[str, Any]) -> Iterator[Thing]:
    """Yield the things of a scene of MoveIt."""
    for each in scene["world"]["collision_objects"]:
        for shape, pose in zip(each["primitives"], each["primitive_poses"], strict=True):
            size = shape["dimensions"]
            is_cylinder = shape["type"] == "cylinder"
            half = [size[1], size[1], 0.5 * size[0]] if is_cylinder else [0.5 * x for x in size]
            R = rotation(*pose["orientation"])
            row = [*R.ravel(), *pose["position"], *half, 0.0, float(is_cylinder)]
            yield Thing(each["id"], np.array(row, dtype=float))


def allowed_pairs(scene: dict[str, Any]) -> set[tuple[str, str]]:
    """Return the pairs of links that may touch."""
    matrix = scene["allowed_collision_matrix"]
    names, values = matrix["entry_names"], matrix["entry_values"]
    pairs = itertools.product(range(len(names)), repeat=2)
    return {(names[i], names[j]) for i, j in pairs if values[i][j]}


def dense(body: PackedBody, path: Array) -> Array:
    """Return a path (k, n) at samples between which nothing moves by more than a millimetre."""
    rows: list[Array] = [path[:1]]
    for a, b in itertools.pairwise(path):
        count = int(np.ceil((body.reach_m @ np.abs(b - a)).max() / _STEP_M)) + 1
        fractions: Array = np.linspace(0.0, 1.0, count + 1)[1:, None]
        rows.append(a + fractions * (b - a))
    return np.vstack(rows)


class Coal:
    """Coal's exact shapes, placed by Pinocchio."""

    def __init__(self, urdf: Path, ignored: set[tuple[str, str]], things: list[Thing]) -> None:
        coal: Any = importlib.import_module("coal")
        pin: Any = importlib.import_module("pinocchio")
        self._pin = pin
        self._model: Any = pin.buildModelFromUrdf(str(urdf))
        self._shapes: Any = pin.buildGeomFromUrdf(
            self._model, str(urdf), pin.GeometryType.COLLISION
        )
        own = list(self._shapes.geometryObjects)
        links = [self._model.frames[each.parentFrame].name for each in own]
        joints = [each.parentJoint for each in own]
        above = list(self._model.parents)
        for i, j in itertools.combinations(range(len(own)), 2):
            # As in MuJoCo, links that one joint or none connects are not compared.
            a, b = joints[i], joints[j]
            if a not in (b, above[b]) and b != above[a] and (links[i], links[j]) not in ignored:
                self._shapes.addCollisionPair(pin.CollisionPair(i, j))
        for thing in things:
            R, p, half = thing.row[:9].reshape(3, 3), thing.row[9:12], thing.row[12:15]
            shape: Any = (
                coal.Cylinder(half[0], 2.0 * half[2]) if thing.row[16] else coal.Box(*(2.0 * half))
            )
            new = self._shapes.addGeometryObject(
                pin.GeometryObject(thing.name, 0, pin.SE3(R, p), shape)
            )
            for i, link in enumerate(links):
                if link != links[0]:
                    self._shapes.addCollisionPair(pin.CollisionPair(i, new))
        self._data, self._placed = self._model.createData(), self._shapes.createData()

    def is_free(self, q: Array) -> bool:
        """Return whether a posture touches nothing."""
        full = self._pin.neutral(self._model)
        for joint, value in zip(list(self._model.joints)[1 : 1 + len(q)], q, strict=True):
            at, size = joint.idx_q, joint.nq
            full[at : at + size] = value if size == 1 else (math.cos(value), math.sin(value))
        return not self._pin.computeCollisions(
            self._model, self._data, self._shapes, self._placed, full, True
        )


class MuJoCo:
    """MuJoCo's own collision detection of the same bodies."""

    def __init__(self, urdf: Path, ignored: set[tuple[str, str]], things: list[Thing]) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self._mujoco = mujoco
        text = urdf.read_text().replace(
            "<link", '<mujoco><compiler discardvisual="true" fusestatic="false"/></mujoco><link', 1
        )
        spec: Any = mujoco.MjSpec.from_string(text)
        for thing in things:
            R, p, half = thing.row[:9].reshape(3, 3), thing.row[9:12], thing.row[12:15]
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, R.ravel().copy())
            kind = mujoco.mjtGeom.mjGEOM_CYLINDER if thing.row[16] else mujoco.mjtGeom.mjGEOM_BOX
            size = [half[0], half[2], 0.0] if thing.row[16] else half
            spec.worldbody.add_geom(
                name=f"thing {thing.name}", type=kind, size=size, pos=p, quat=quaternion
            )
        self._model: Any = spec.compile()
        self._data: Any = mujoco.MjData(self._model)
        self._ignored = ignored
        self._base = self._model.body(1).name
        self._links = [self._model.body(i).name for i in self._model.geom_bodyid]

    def is_free(self, q: Array) -> bool:
        """Return whether a posture touches nothing."""
        self._data.qpos[: len(q)] = q
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_collision(self._model, self._data)
        for contact in self._data.contact[: self._data.ncon]:
            one, other = (self._links[i] for i in contact.geom)
            fixed = {one, other} <= {"world", self._base}
            if contact.dist < 0.0 and not fixed and (one, other) not in self._ignored:
                return False
        return True


def problems(folder: Path, urdf: Path, tip: str, every: int, by: list[str], judged: bool) -> None:
    """Solve MotionBenchMaker's problems of an arm by some planners, each in turn."""
    yaml: Any = importlib.import_module("yaml")
    total = {each: list[Judged]() for each in by}
    touching, confirmed = 0, 0
    # Leave out a fixed finger that mimics a fixed one, and visual shapes, which would count as
    # collision shapes of links that have no others.
    fixed = Path(tempfile.mkdtemp()) / "arm.urdf"
    unseen = r"<mimic[^>]*>(</mimic>)?|<visual>.*?</visual>"
    fixed.write_text(re.sub(unseen, "", urdf.read_text(), flags=re.DOTALL))
    urdf, model = fixed, load_model(fixed, tip=tip)
    for kind in sorted(folder.iterdir()):
        found = {each: list[Judged]() for each in by}
        for request_file in sorted(kind.glob("request*.yaml"))[::every]:
            request = yaml.load(request_file.read_text(), Loader=yaml.CSafeLoader)
            scene_file = kind / request_file.name.replace("request", "scene")
            scene = yaml.load(scene_file.read_text(), Loader=yaml.CSafeLoader)
            state = request["start_state"]["joint_state"]
            started = dict(zip(state["name"], state["position"], strict=True))
            start_q = np.array([started[name] for name in model.chain.names])
            by_name = {
                each["joint_name"]: each["position"]
                for each in request["goal_constraints"][0]["joint_constraints"]
            }
            goal = np.array([by_name[name] for name in model.chain.names])
            inside = np.clip(goal, model.chain.lower_rad, model.chain.upper_rad)
            goal = np.where(np.abs(goal - inside) < _ROUNDED_RAD, inside, goal)
            things, ignored = list(things_of(scene)), allowed_pairs(scene)
            body = CollisionBody(model.chain, capsules_of(model))
            checker = CollisionChecker(body, None, cast("Any", things))
            checker.watched[:] = [
                pair not in ignored and (pair[0] != model.chain.base or pair in body.pairs)
                for pair in checker.pairs
            ]
            judges = [judge(urdf, ignored, things) for judge in ((Coal, MuJoCo) if judged else ())]
            ends = np.array([start_q, goal])
            if (checker.distances(ends) < 0.0).any():
                touching += 1
                confirmed += bool(judges) and not all(judges[0].is_free(q) for q in ends)
                continue
            for planner in by:
                began = time.process_time()
                space = checker.clear_space(_SETTLED_MARGIN_M, ends, load=0.0)
                limits = model.chain.lower_rad, model.chain.upper_rad
                path = PLANNERS[planner](space, start_q, goal, *limits)
                seconds, free = time.process_time() - began, dict[str, bool]()
                if path is not None:
                    samples = dense(checker.body, path)
                    for judge in judges:
                        free[type(judge).__name__] = all(judge.is_free(q) for q in samples)
                found[planner].append(Judged(seconds, path, free))
        for planner in by:
            report(f"{kind.name} {planner}", found[planner])
            total[planner] += found[planner]
    for planner in by:
        report(f"all {planner}", total[planner])
    print(f"left out because an end touches something: {touching}, Coal confirms {confirmed}")


def find_by_ikservo(
    space: ClearSpace, start: Array, goal: Array, lower: Array, upper: Array
) -> Array | None:
    """Return postures (k, n) from a start to a goal; None if none was found."""
    return WaySearch(space, start, goal[None], lower, upper).find(_MOST)


PLANNERS: dict[str, Callable[..., Array | None]] = {
    "ikservo": find_by_ikservo,
    "ompl": partial(find_by_ompl, most_s=_MOST_S),
    "sscbirrt": partial(find_by_sscbirrt, most_s=_MOST_S),
}


def report(name: str, found: list[Judged]) -> None:
    """Print a line of the table."""
    solved = [each for each in found if each.path is not None]
    times_ms = 1e3 * np.array([each.seconds for each in solved] or [0.0])
    judged = {
        who: sum(each.free[who] for each in solved) for who in (solved[0].free if solved else ())
    }
    lengths = [path_length(each.path) for each in solved if each.path is not None]
    print(
        f"{name:34} {len(solved):4} of {len(found):4}  median {np.median(times_ms):7.1f} ms"
        f"  p95 {np.percentile(times_ms, 95):8.1f} ms"
        f"  length {np.median(lengths or [0.0]):.2f} rad  free: {judged}",
        flush=True,
    )


class StandsAt:
    """A held arm in the posture in which a motion would start."""

    def __init__(self, q: Array) -> None:
        self._q = q

    def start_position(self) -> Array:
        """Return the posture."""
        return self._q

    def allowed_speed(self, speed: str) -> str:
        """Return the speed class."""
        return speed

    def enable(self) -> None:
        """Do nothing."""


class Searches:
    """Paths around obstacles, and the processor time that it took to find and prove them."""

    def __init__(self) -> None:
        self._find, self.seconds = ways_around.ways_around, 0.0

    def __call__(self, *asked: Any, **options: Any) -> Iterator[Array]:  # noqa: ANN401
        """Yield the paths of a search."""
        ways = self._find(*asked, **options)
        while True:
            began = time.process_time()
            way = next(ways, None)
            self.seconds += time.process_time() - began
            if way is None:
                return
            yield way


def arms(names: list[str], scenes: int, upright_deg: float | None, seeds: int, by: str) -> None:
    """Plan from random starts to random goals among one to five random boxes.

    Args:
        names: The arms.
        scenes: Number of scenes per arm.
        upright_deg: Largest tilt of the tool on the path. Goals are then reached by steps that keep
            it, without regard to the boxes, because an arm of five joints cannot turn its tool
            over. The first goal of a scene to which no straight path leads is taken.
        seeds: Number of paths with which the length is compared, at the same distances from things.
        by: The planner that is asked for paths that were not found, without a distance to things.
    """
    turned_rad = None if upright_deg is None else math.radians(upright_deg)
    within = PathConstraint(upright_rad=turned_rad)
    searches = ways_around.ways_around = Searches()
    for name in names:
        found, ratios, straight, searched_s = list[Judged](), list[float](), 0, list[float]()
        model = load_model(name)
        for seed in range(scenes):
            chance = random.Random(f"{name} {seed}")
            boxes = tuple(random_box(chance, i) for i in range(chance.randint(1, 5)))
            with open_own_arm(replace(model, keep_out=boxes), port="sim") as arm:
                context = arm.context
                checker = cast("CollisionChecker", context.collision)
                ends = free_ends(context, checker, chance, within)
                if ends is None:
                    continue
                preflight = PreflightPlanner(context, StandsAt(ends[0]), PoseLibrary(model, ""))
                for goal in ends[1:].tolist():
                    goals = dict(zip(arm.joint_names, goal, strict=True))
                    motion = MoveJoints(goals, within=within)
                    began, plan, searches.seconds = time.process_time(), None, 0.0
                    with suppress(RefusedError):
                        plan = preflight.plan(motion)
                    seconds = time.process_time() - began
                    if plan is None or plan.around:
                        break
                else:
                    straight += 1
                    continue
                way = None if plan is None else plan.sample(0.02).positions
                found.append(Judged(seconds, way, {}))
                searched_s += [searches.seconds] if plan is not None else []
                if plan is None:
                    print(f"not solved: {name} {seed}, {seconds:.2f} s", end="", flush=True)
                    print("" if by == "ikservo" else f"; {find_by_other(by, preflight, motion)}")
                elif seeds:
                    ratios.append(joint_length(plan) / best_length(preflight, motion, seeds))
        print(f"{straight} straight")
        report(name, found)
        middle, most = 1e3 * np.percentile(searched_s or [0.0], (50, 95))
        print(f"  search and proof: median {middle:.1f} ms, p95 {most:.1f} ms")
        if ratios:
            middle, most = np.percentile(ratios, (50, 95))
            print(f"  length to best of {seeds}: median {middle:.2f}, p95 {most:.2f}", end="")
            print(f", most {max(ratios):.2f}, {len(ratios)} paths")


def find_by_other(by: str, preflight: PreflightPlanner, motion: MoveJoints) -> str:
    """Return the result of another planner if ours finds nothing."""
    paths = list[Array | None]()

    class Other(WaySearch):
        def find(self, most: int, is_over: Callable[[], bool] = bool) -> Array | None:
            del most, is_over
            paths.append(PLANNERS[by](self._space, self._start, self._goals[0], *self._limits))
            self.has_ended = True
            return paths[-1]

    own, kept = ways_around.WaySearch, ways_around.MARGINS_M
    ways_around.WaySearch, ways_around.MARGINS_M = Other, (0.0, 0.0)
    try:
        with suppress(RefusedError):
            preflight.plan(motion)
            return f"solved by {by}"
    finally:
        ways_around.WaySearch, ways_around.MARGINS_M = own, kept
    found = any(path is not None for path in paths)
    return f"{by} finds a path that touches something" if found else f"not by {by} either"


def joint_length(plan: MotionPlan) -> float:
    """Return the length of the joints' path, rad."""
    return path_length(plan.sample(0.02).positions)


def best_length(preflight: PreflightPlanner, motion: MoveJoints, seeds: int) -> float:
    """Return the length of the shortest of the paths of some seeds, rad."""
    lengths, own = list[float](), ways_around.WaySearch
    try:
        for seed in range(1, 1 + seeds):
            ways_around.WaySearch = partial(own, seed=seed)  # pyright: ignore[reportAttributeAccessIssue]
            with suppress(RefusedError):
                lengths.append(joint_length(preflight.plan(motion)))
    finally:
        ways_around.WaySearch = own
    return min(lengths)


def free_ends(
    context: ArmContext, checker: CollisionChecker, chance: random.Random, within: PathConstraint
) -> Array | None:
    """Return a start and goals (1 + k, n) that are free with and without sag; None if rare."""
    lower, upper = context.limits()
    postures = np.array([
        [chance.uniform(a, b) for a, b in zip(lower, upper, strict=True)] for _ in range(300)
    ])  # fmt: skip
    load = context.planner.dynamic_load_factor("normal")

    def are_free(joints: Array) -> NDArray[np.bool_]:
        near_m = checker.distances_with_sag(context.index.body_joints(joints), load)
        return near_m.min(axis=1) > _SETTLED_MARGIN_M

    free = postures[are_free(postures)]
    tool = context.planner.constrained_tool(within, free[0]) if len(free) else None
    if tool is None:
        free = free[:2]
    else:
        goals = np.array(list(islice(walk(tool, context.index, free, chance), 40)))
        free = np.vstack([free[:1], goals[are_free(goals)]])
    return free if len(free) > 1 else None


def walk(
    tool: ConstrainedTool,
    index: JointIndex,
    postures: Array,
    chance: random.Random,
) -> Iterator[Array]:
    """Yield postures (n,), reached by short steps that all keep a constraint."""
    q = start = index.chain_joints(postures[0])
    while True:
        for _ in range(20):
            aim = index.chain_joints(chance.choice(postures))
            for _ in range(20):
                away = aim - q
                far = max(float(np.linalg.norm(away)), _WALK_RAD)
                step = tool.project(q + _WALK_RAD / far * away)
                if step is None or np.linalg.norm(step - q) > 2.0 * _WALK_RAD:
                    break
                q = step
        yield index.with_chain(postures[0], q)
        q = start


def random_box(chance: random.Random, number: int) -> KeepOutBox:
    """Return a box around the arm."""
    centre = np.array(
        [chance.uniform(-0.1, 0.35), chance.uniform(-0.3, 0.3), chance.uniform(0.02, 0.3)]
    )
    half = np.array([chance.uniform(0.01, 0.06) for _ in range(3)])
    return KeepOutBox(f"box {number}", tuple(centre - half), tuple(centre + half))


def main() -> None:
    """Run the requested part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["panda", "arms"])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--urdf", type=Path)
    parser.add_argument("--tip", default="panda_hand", help="the last link of the chain")
    parser.add_argument("--unjudged", action="store_true", help="no check by Coal and MuJoCo")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem")
    parser.add_argument("--by", choices=PLANNERS, nargs="+", default=["ikservo"])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--arms", nargs="+", default=_ARMS)
    parser.add_argument("--upright", type=float, help="degrees that the tool may tilt")
    parser.add_argument("--best-of", type=int, default=0, help="seeds to compare lengths with")
    given = parser.parse_args()
    if given.part == "panda":
        problems(given.folder, given.urdf, given.tip, given.every, given.by, not given.unjudged)
    else:
        arms(given.arms, given.scenes, given.upright, given.best_of, given.by[0])


if __name__ == "__main__":
    main()

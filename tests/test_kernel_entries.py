"""Compiled kernels reject wrong arguments and never write outside their outputs.

Under ``make sanitize`` every index is checked as well, and an index out of range ends the process.
"""

import array

import numpy as np
import pytest

from ikservo.guard import CollisionChecker, clear_space, path_search
from ikservo.guard.sag import GravitySag, Weight
from ikservo.ik import Solver, branch_tracking
from ikservo.ik.prepare import TargetKind
from ikservo.kernels import capsule_distances as collision_kernel
from ikservo.kernels import compiled, search, single, tool_limits
from ikservo.kernels import free_path as free_path_kernel
from ikservo.kernels import way_search as way_search_kernel
from ikservo.kinematics.inertia import LinkMass
from ikservo.model import load_model
from ikservo.planning.path_constraint import ConstrainedTool, PathConstraint
from tests.both_ways import needs_extension
from tests.guard.test_collision_kernel import BOXES, every_kind_of_joint
from tests.ik.test_compiled import Search

TRIALS = 300
REFUSALS = (TypeError, ValueError, BufferError, OverflowError)
NUMBERS = (0.0, -1.0, 0.5, 7.0, 1e9, -1e300, np.inf, -np.inf, np.nan)
KINDS = ("f4", "i4", "i8", "u8", "?", "c16", ">f8", ">i8", "S8", "O")
SCALARS = (None, "x", b"x", np.nan, np.inf, 10**30, -1, True, 2.5, [1.0], np.zeros(3))


def solve_all(_):
    return search.solve_all(*Search("so101", TargetKind.POSE, 1, 3, traced=6).arguments())


def solve_pose(monkeypatch):
    model, names = load_model("wx250s"), []

    def bind(name, *arguments):
        names.append(name)
        return lambda *others: getattr(single, name)(*arguments, *others)

    with monkeypatch.context() as patch:
        patch.setattr(branch_tracking, "bind", bind)
        Solver(model.chain, "direction")(np.eye(4), model.chain_pose("home"))


def is_target(_):
    return single.is_target(np.vstack([np.zeros(3), np.eye(3)]), True)


def min_distances(_):
    checker = CollisionChecker(every_kind_of_joint(), 0.02, BOXES)
    checker.distances(np.zeros((3, checker.dof)))


def gravity_torques_kernel(_):
    masses = [LinkMass(link, 0.3, np.array([0.02, 0.01, -0.03])) for link in ("arm", "hand")]
    free = np.full(4, np.inf)
    GravitySag(every_kind_of_joint(), Weight(masses, np.ones(4), -free, free))(np.zeros((3, 4)))


def first_contact(monkeypatch):
    def bind(name, *arguments):
        return lambda *others: getattr(free_path_kernel, name)(*arguments, *others)

    with monkeypatch.context() as patch:
        patch.setattr(clear_space, "bind", bind)
        space = CollisionChecker(every_kind_of_joint(), 0.02, BOXES).clear_space(0.01)
        space.is_free(np.array([np.zeros(4), 0.1 * np.ones(4)]))
        space.contains(np.zeros((2, 4)))


def find_way(monkeypatch):
    def bind(name, *arguments):
        return lambda *others: getattr(way_search_kernel, name)(*arguments, *others)

    with monkeypatch.context() as patch:
        patch.setattr(path_search, "bind", bind)
        patch.setattr(path_search, "_NODES", 50)
        space = CollisionChecker(every_kind_of_joint(), 0.02, BOXES).clear_space(0.0, load=0.0)
        found = path_search.WaySearch(space, np.zeros(4), np.ones((1, 4)), -np.ones(4), np.ones(4))
        found.has_ended = False
        found._goals = np.ones((1, 4))
        found._plant(found._limits)
        found._grow_trees(0.1, 200)
        found._shortened(np.array([np.zeros(4), 0.1 * np.ones(4), np.zeros(4)]), 0.1)


def project_tool(_):
    model = load_model("so101")
    constraint = PathConstraint(upright_rad=0.2, above_m=(0, 0, 0.1))
    tool = ConstrainedTool(constraint, model.chain, np.eye(3)[0], model.chain_pose("home"))
    tool.project(model.chain_pose("home") + 0.3, np.array([0.2, 0.0, 0.2]))


ENTRIES = [
    (search, "solve_all", solve_all),
    (single, "solve_pose", solve_pose),
    (single, "is_target", is_target),
    (tool_limits, "tool_poses", project_tool),
    (tool_limits, "project_tool", project_tool),
    (collision_kernel, "min_distances", min_distances),
    (collision_kernel, "gravity_torques_kernel", gravity_torques_kernel),
    (free_path_kernel, "first_contact", first_contact),
    (free_path_kernel, "free_postures", first_contact),
    (way_search_kernel, "grow_trees", find_way),
    (way_search_kernel, "shorten_way", find_way),
]


def test_every_compiled_kernel_function_is_tested():
    assert {name for _, name, _ in ENTRIES} == set(compiled.uncompiled)


def copied(arguments):
    return [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]


def arguments_of(monkeypatch, module, name, run):
    """Return the arguments of a kernel's call."""
    kernel, calls = getattr(module, name), []

    def record(*arguments):
        calls.append(copied(arguments))
        return kernel(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, record)
        run(monkeypatch)
    return calls[0]


def with_one_number_changed(random, a):
    a = a.copy()
    if a.size:
        number = random.choice(NUMBERS)
        whole = a.dtype.kind == "i"
        a.flat[random.integers(a.size)] = int(random.choice([-1, 0, 9, 2**62])) if whole else number
    return a


def of_another_shape(random, a):
    shape = list(a.shape)
    shape[random.integers(a.ndim)] += int(random.choice([-1, 1, -(10**6), 5]))
    new = np.zeros([max(n, 0) for n in shape], a.dtype)
    common = tuple(slice(min(n, m)) for n, m in zip(new.shape, a.shape, strict=True))
    new[common] = a[common]
    return new


def in_another_way(random, a):
    """Return the array with other strides, dimensions or type, or another object."""
    read_only = a.copy()
    read_only.flags.writeable = False
    ways = [
        a[::-1], np.repeat(a, 2, axis=-1)[..., ::2], a.T, np.asfortranarray(a), a[None], a.ravel(),
        a[..., None], np.broadcast_to(a[:1], a.shape) if len(a) else a, read_only, a.tolist(), None,
        a.astype(random.choice(KINDS)), np.empty(0), np.float64(1.0), memoryview(a.tobytes()),
        bytearray(a.tobytes()), array.array("d", np.ravel(a).astype(float)), "array", a.view("i8"),
    ]  # fmt: skip
    return ways[random.integers(len(ways))]


def changed(random, arguments):
    """Return changed arguments: some different, some missing, some too many."""
    given = copied(arguments)
    for i in set(random.integers(len(given), size=random.integers(1, 4)).tolist()):
        if isinstance(given[i], np.ndarray) and given[i].ndim:
            ways = (
                with_one_number_changed,
                with_one_number_changed,
                of_another_shape,
                in_another_way,
            )
            given[i] = ways[random.integers(len(ways))](random, given[i])
        else:
            given[i] = SCALARS[random.integers(len(SCALARS))]
    if random.integers(20) == 0:
        return given[: random.integers(len(given))]
    return [*given, given[0]] if random.integers(20) == 0 else given


@needs_extension
@pytest.mark.filterwarnings("ignore")  # of complex numbers that become real ones
@pytest.mark.parametrize(("module", "name", "run"), ENTRIES, ids=[name for _, name, _ in ENTRIES])
def test_compiled_kernels_survive_or_refuse_random_arguments(monkeypatch, module, name, run):
    arguments = arguments_of(monkeypatch, module, name, run)
    random, refused = np.random.default_rng(1), 0
    first = copied(arguments)
    result = compiled.bind(name)(*first)
    for _ in range(TRIALS):
        given = changed(random, arguments)
        bound = random.integers(len(given) + 1)
        try:
            compiled.bind(name, *given[:bound])(*given[bound:])
        except REFUSALS:
            refused += 1
    assert TRIALS // 4 < refused < TRIALS
    again = copied(arguments)
    assert compiled.bind(name)(*again) == result
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)

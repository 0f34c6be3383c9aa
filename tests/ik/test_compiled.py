"""The compiled kernels equal the Python code bit for bit, and refuse wrong arguments."""

import json
import math
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ikservo.ik.branch_tracking import Solver
from ikservo.ik.prepare import TargetKind, pack_problem, pack_settings
from ikservo.ik.problem import DEFAULT_RESTARTS, Options
from ikservo.kernels import compiled, search, single
from ikservo.kernels.layout import (
    KIND,
    PROBLEM_SIZE,
    RESTARTS,
    RESULT_TAIL,
    SCORE_ROWS,
    SETTINGS_SIZE,
    work_shape,
)
from ikservo.model import load_model

needs_extension = pytest.mark.skipif(not compiled.is_compiled(), reason="no C compiler")
ARMS = ("so101", "wx250s", "koch")
RESTART_COUNT = 20
ROOT = Path(__file__).parents[2]
# PyPy needs a tenth of the time that NumPy's arrays take in this Python.
PYPY = shutil.which("pypy3")


class Search:
    """The arguments of ``solve_all`` for one arm, kind and targets in or out of reach."""

    def __init__(
        self, name, kind, seed, count, *,
        stretched=1.0, turned=False, traced=0, restarts=RESTART_COUNT,
    ):  # fmt: skip
        chain = load_model(name).chain
        rng, n = np.random.default_rng(seed), chain.dof
        T = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad, (count, n)))
        if turned:  # to the orientations of other targets
            T[:, :3, :3] = np.roll(T[:, :3, :3], 1, axis=0)
        problem = pack_problem(chain, None, None, None, restarts)
        self.arm, self.seeds = problem.arm, problem.seeds
        self.problems = np.zeros((count, PROBLEM_SIZE))
        self.problems[:, :3] = stretched * T[:, :3, 3]
        self.problems[:, 3:] = T[:, :3, :3].reshape(-1, 9)
        self.settings = pack_settings(kind, n, Options(restarts=restarts))
        self.starts = rng.uniform(chain.lower_rad, chain.upper_rad, (count, n))
        self.work = np.zeros(work_shape(n, restarts))
        self.scores = np.zeros((SCORE_ROWS, restarts))
        self.trace = np.zeros((traced, n))
        self.results = np.zeros((count, 2 * n + RESULT_TAIL))

    def arguments(self, **changed):
        names = ("arm", "problems", "settings", "starts", "seeds", "work", "scores", "trace")
        return [changed.get(name, getattr(self, name)) for name in (*names, "results")]


def with_numpy(*arguments):
    """Run the kernel as Python on NumPy's arrays."""
    return compiled.uncompiled["solve_all"](*arguments)


def without_numpy(*arguments, folder=ROOT):
    """Run the kernel of a folder as Python in another process, with Python's own numbers."""
    shapes = json.dumps([each.shape for each in arguments]).encode()
    command = [
        PYPY or sys.executable,
        "-I",
        "-B",
        ROOT / "tools/kernel/run_without_numpy.py",
        folder,
    ]
    numbers = b"".join(each.tobytes() for each in arguments)
    done = subprocess.run(command, input=shapes + b"\n" + numbers, stdout=-1, check=True)
    line, _, numbers = done.stdout.partition(b"\n")
    for each in arguments:
        each[...] = np.frombuffer(numbers[: each.nbytes]).reshape(each.shape)
        numbers = numbers[each.nbytes :]
    assert not numbers
    return json.loads(line)


def same_both_ways(name, kind, seed, count, *, uncompiled=with_numpy, **options):
    """Return the fraction of targets that were reached; compiled and uncompiled must agree."""
    one, other = (Search(name, kind, seed, count, **options) for _ in range(2))
    assert search.solve_all(*one.arguments()) == -1
    assert uncompiled(*other.arguments()) == -1
    for array in ("results", "trace", "scores", "work"):
        same = getattr(one, array).tobytes() == getattr(other, array).tobytes()
        assert same, f"{array} differ"
    return float(np.mean(one.results[:, -RESULT_TAIL]))


@needs_extension
@pytest.mark.parametrize("kind", TargetKind)
@pytest.mark.parametrize("name", ARMS)
def test_compiled_search_equals_python_search(name, kind):
    assert same_both_ways(name, kind, 1, 12, traced=40) > 0.9


@pytest.mark.sample(2)
@needs_extension
@pytest.mark.parametrize("uncompiled", [with_numpy, without_numpy])
@pytest.mark.parametrize("kind", TargetKind)
def test_compiled_and_python_search_agree_on_far_target(kind, uncompiled):
    options = {"stretched": 3.0, "traced": 40, "uncompiled": uncompiled}
    assert same_both_ways("so101", kind, 2, 1, **options) == 0.0


@pytest.mark.full
@pytest.mark.sample(1)
@needs_extension
@pytest.mark.parametrize("uncompiled", [with_numpy, without_numpy])
@pytest.mark.parametrize("kind", [TargetKind.DIRECTION, TargetKind.POSE])
def test_compiled_search_equals_python_for_unreached_direction(kind, uncompiled):
    options = {"turned": True, "traced": 40, "uncompiled": uncompiled}
    assert same_both_ways("so101", kind, 2, 2, **options) == 0.0


CHANGES = {
    "descent": ("radius / longest if", "radius * (1.0 / longest) if"),
    "forward_kinematics": ("p0 += a * x0 + b * y0 + c * z0", "p0 += c * z0 + b * y0 + a * x0"),
    "linear_algebra": (
        "i, k] * (work[A + j, k] * work[A + k, k])",
        "i, k] * work[A + j, k] * work[A + k, k]",
    ),
    "nullspace": ("= s * work[FREE, j]", "= 1.0000000000000002 * s * work[FREE, j]"),
}


@pytest.mark.full
@pytest.mark.sample(2)
@needs_extension
@pytest.mark.parametrize("module", CHANGES)
def test_kernel_changed_in_last_digit_is_detected(module, tmp_path):
    for package in ("kernels", "kinematics"):
        shutil.copytree(ROOT / "ikservo" / package, tmp_path / "ikservo" / package)
    kernel = tmp_path / "ikservo" / "kernels" / f"{module}.py"
    code, (old, new) = kernel.read_text("utf-8"), CHANGES[module]
    assert code.count(old) == 1
    kernel.write_text(code.replace(old, new), "utf-8")
    changed = partial(without_numpy, folder=tmp_path)
    with pytest.raises(AssertionError, match="differ"):
        same_both_ways("so101", TargetKind.POSE, 2, 4, turned=True, uncompiled=changed)


@needs_extension
@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("kind", TargetKind)
@pytest.mark.parametrize("name", ARMS)
def test_compiled_search_equals_python_in_campaign(name, kind, part):
    options = {"restarts": DEFAULT_RESTARTS, "uncompiled": without_numpy if PYPY else with_numpy}
    assert same_both_ways(name, kind, part, 995, **options) > 0.99
    assert same_both_ways(name, kind, part, 5, stretched=3.0, **options) < 1.0
    same_both_ways(name, kind, part, 5, turned=True, **options)


@pytest.mark.parametrize(
    ("argument", "shape"),
    [
        ("arm", (1, 17)),
        ("arm", (8, 17)),
        ("arm", (12, 16)),
        ("problems", (3, 11)),
        ("problems", (2, 12)),
        ("settings", (8,)),
        ("starts", (3, 4)),
        ("starts", (4, 5)),
        ("seeds", (20, 19)),
        ("seeds", (21, 18)),
        ("work", (57, 12)),
        ("work", (58, 11)),
        ("scores", (3, 20)),
        ("scores", (4, 19)),
        ("trace", (10, 4)),
        ("results", (3, 18)),
        ("results", (2, 19)),
        ("results", (0, 0)),
    ],
)
@pytest.mark.parametrize("way", ["compiled", "uncompiled"])
def test_solve_all_refuses_arrays_of_wrong_shape(way, argument, shape):
    run = search.solve_all if way == "compiled" else compiled.uncompiled["solve_all"]
    call = Search("so101", TargetKind.POSITION, 1, 3)
    old = getattr(call, argument)
    new = np.zeros(shape)
    common = tuple(slice(min(a, b)) for a, b in zip(shape, old.shape, strict=True))
    new[common] = old[common]
    with pytest.raises(ValueError, match="match"):
        run(*call.arguments(**{argument: new}))


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [(0, 0, 4.0), (0, 0, 1e300), (0, 1, -1.0), (1, 13, 5.0), (5, 13, -1.0), (3, 13, math.nan)],
)
def test_packed_arm_with_index_out_of_range_is_refused(row, column, value):
    call = Search("so101", TargetKind.POSITION, 1, 1)
    arm = call.arm.copy()
    arm[row, column] = value
    with pytest.raises(ValueError, match="match"):
        search.solve_all(*call.arguments(arm=arm))


@pytest.mark.parametrize("way", ["compiled", "uncompiled"])
@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.astype(np.float32),
        lambda a: a.astype(np.int64),
        lambda a: a[:, :, None],
        lambda a: a.ravel(),
        lambda a: a.tolist(),
        lambda _: None,
    ],
)
def test_compiled_solver_refuses_array_of_wrong_dtype(way, change):
    run = search.solve_all if way == "compiled" else compiled.uncompiled["solve_all"]
    call = Search("so101", TargetKind.POSITION, 1, 3)
    with pytest.raises(TypeError):
        run(*call.arguments(problems=change(call.problems)))


@needs_extension
@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.astype(">f8"),
        np.asfortranarray,
        lambda a: np.repeat(a, 2, axis=1)[:, ::2],
    ],
)
def test_compiled_solver_refuses_wrong_byte_or_memory_order(change):
    call = Search("so101", TargetKind.POSITION, 1, 3)
    with pytest.raises((TypeError, ValueError, BufferError)):
        search.solve_all(*call.arguments(problems=change(call.problems)))


@needs_extension
def test_solve_all_needs_only_result_array_writable():
    call = Search("so101", TargetKind.POSITION, 1, 3)
    for array in (call.arm, call.problems, call.settings, call.starts, call.seeds):
        array.flags.writeable = False
    assert search.solve_all(*call.arguments()) == -1
    call.results.flags.writeable = False
    with pytest.raises((ValueError, BufferError)):
        search.solve_all(*call.arguments())


@needs_extension
@pytest.mark.parametrize("count", [0, 8, 10])
def test_solve_all_refuses_wrong_number_of_arguments(count):
    call = Search("so101", TargetKind.POSITION, 1, 3)
    with pytest.raises(TypeError):
        search.solve_all(*[*call.arguments(), None][:count])


@needs_extension
@pytest.mark.parametrize("kind", ["position", "direction", "pose"])
def test_compiled_solver_equals_python_solver(monkeypatch, kind):
    model = load_model("so101")
    chain, rng = model.chain, np.random.default_rng(5)
    T = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad, (8, chain.dof)))
    one = Solver(chain, kind, tool_axis=(1.0, 0.0, 0.0))
    monkeypatch.setattr(compiled, "_extension", lambda: None)
    other, q0 = Solver(chain, kind, tool_axis=(1.0, 0.0, 0.0)), model.chain_pose("home")
    for pose in T:
        for name in ("__call__", "track"):
            q, reached = getattr(one, name)(pose, q0)
            python_q, python_reached = getattr(other, name)(pose, q0)
            assert q.tobytes() == python_q.tobytes()
            assert reached == python_reached


@pytest.mark.parametrize("way", ["compiled", "uncompiled"])
@pytest.mark.parametrize(
    ("position", "rotation", "accepted"),
    [
        ((0.3, 0.1, 0.0), np.eye(3), (True, True)),
        ((0.3, 0.1, 0.0), 1.00001 * np.eye(3), (True, False)),
        ((0.3, 0.1, 0.0), np.diag([1.0, 1.0, -1.0]), (True, False)),
        ((0.3, 0.1, math.nan), np.eye(3), (False, False)),
        ((1001.0, 0.1, 0.0), np.eye(3), (False, False)),
    ],
)
def test_compiled_target_check_accepts_only_valid_numbers(way, position, rotation, accepted):
    judge = single.is_target if way == "compiled" else compiled.uncompiled["is_target"]
    packed = np.vstack([position, rotation])
    assert (judge(packed, False), judge(packed, True)) == accepted


@pytest.mark.parametrize(
    "change", [np.asfortranarray, lambda T: T.tolist(), lambda T: T.astype("f4")]
)
def test_ik_solver_accepts_any_array_layout_list_and_float32(change):
    model = load_model("so101")
    solver, T = Solver(model.chain, "pose"), np.eye(4)
    T[:3, 3] = 0.25, 0.0, 0.125
    q0 = model.chain_pose("home")
    plain = solver(T, q0)[0]
    joints = np.empty((5, 2))
    q, _ = solver(change(T), q0.tolist(), joints[:, 1])
    assert q.base is joints
    np.testing.assert_array_equal(q, plain)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("argument", ["problems", "starts"])
def test_compiled_batch_reports_index_of_invalid_problem(argument, value):
    call = Search("so101", TargetKind.POSE, 1, 3)
    getattr(call, argument)[1, 2] = value
    assert search.solve_all(*call.arguments()) == 1
    assert not call.results.any()


@pytest.mark.full
@needs_extension
def test_invalid_ik_settings_behave_same_compiled_and_python():
    rng, same = np.random.default_rng(3), 0
    for _ in range(40):
        kind = TargetKind(int(rng.integers(3)))
        seed = int(rng.integers(1000))
        one, other = (Search("wx250s", kind, seed, 2) for _ in range(2))
        settings = one.settings.copy()
        for i in rng.integers(SETTINGS_SIZE, size=2):
            settings[i] = rng.choice([0.0, -1.0, 0.5, 3.0, 1e9, -1e300, math.inf, math.nan])
        settings[KIND] = kind
        settings[RESTARTS] = min(settings[RESTARTS], 2.0) if settings[RESTARTS] >= 1.0 else 1.0
        first = search.solve_all(*one.arguments(settings=settings))
        try:
            second = compiled.uncompiled["solve_all"](*other.arguments(settings=settings))
        except ValueError:  # a NaN that Python makes no whole number of
            continue
        same += 1
        assert first == second
        np.testing.assert_array_equal(one.results, other.results)
    assert same > 20


@pytest.mark.full
@needs_extension
def test_modified_kernel_runs_as_python_with_warning(tmp_path):
    package = Path(compiled.__file__).parents[1]
    copy = tmp_path / "ikservo"
    subprocess.run(["cp", "-r", package, copy], check=True)
    kernel = copy / "kernels" / "descent.py"
    kernel.write_text(kernel.read_text() + "\n# changed\n")
    done = warning_of(
        "from ikservo.kernels import compiled; print(compiled.is_compiled())", tmp_path
    )
    assert done.stdout.split() == ["False"]
    assert "make build" in done.stderr


@pytest.mark.full
def test_solve_without_compiled_extension_is_bitwise_identical():
    code = (
        "import ikservo; m = ikservo.load_model('so101');"
        "r = ikservo.solve(m.chain, ikservo.Target((0.25, 0.05, 0.15)), m.chain_pose('home'));"
        "from ikservo.kernels import compiled;"
        "print(compiled.is_compiled(), [x.hex() for x in r.q.tolist()])"
    )
    here = Path(compiled.__file__).parents[2]
    plain = warning_of(code, here, IKSERVO_COMPILED="0").stdout
    assert plain.startswith("False")
    if compiled.is_compiled():
        assert warning_of(code, here).stdout == plain.replace("False", "True")


def warning_of(code, folder, **environment):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=os.environ | environment,
        capture_output=True, text=True, check=True,
    )  # fmt: skip

"""Among several solutions the nearest to the start is returned, unless speed alone matters."""

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.ik import Options, Posture, Solver, Target, solve
from ikservo.ik.closed_form import solutions
from ikservo.ik.other_solutions import nearest_solution
from ikservo.model import load_model


def questions(name, kind, count, seed=1):
    """Yield an arm, reachable targets and the start, its home."""
    model = load_model(name)
    chain, rng = model.chain, np.random.default_rng(seed)
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof)):
        T = chain.forward(q)
        yield chain, target_of(T, kind), model.chain_pose("home")


def target_of(T, kind):
    return Target(
        T[:3, 3],
        direction=T[:3, 2] if kind == "direction" else None,
        orientation=T[:3, :3] if kind == "pose" else None,
    )


def way(q, q0):
    return float(np.linalg.norm(q - q0))


@pytest.mark.parametrize("kind", ["position", "direction", "pose"])
@pytest.mark.parametrize("name", ["wx250s", "vx300s", "so101"])
def test_solve_returns_closed_form_solution_nearest_to_start(name, kind):
    for chain, target, q0 in questions(name, kind, 25):
        result = solve(chain, target, q0)
        assert result.reached
        known = [way(q, q0) for q in solutions(chain, target, q0)]
        assert way(result.q, q0) <= min(known, default=np.inf) + 1e-6


def test_solution_without_nearest_option_can_be_farther():
    ways = [
        (way(solve(chain, target, q0, nearest=False).q, q0), way(solve(chain, target, q0).q, q0))
        for chain, target, q0 in questions("wx250s", "pose", 30)
    ]
    assert all(near <= first + 1e-9 for first, near in ways)
    assert any(near < first - 0.1 for first, near in ways)


def test_nearest_option_reduces_motion_without_closed_form():
    first, better, best = 0.0, 0.0, 0.0
    for chain, target, q0 in questions("wx250s", "pose", 40):
        bent = _bent(chain)
        result = solve(bent, target_of(bent.forward(chain.mid_range() + 0.4), "pose"), q0)
        assert result.reached
        found = solve(chain, target, q0, nearest=False)
        first += way(found.q, q0)
        best += way(solve(chain, target, q0).q, q0)
        better += way(around(chain, target, q0, found).q, q0)
    assert better < 0.5 * (first + best)


def around(chain, target, q0, found):
    """Return the solutions of walks from around the start, as without a closed form."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ikservo.ik.other_solutions.recognise_structure", lambda *_: None)
        return nearest_solution(chain, target, q0, Options(), found)


def _bent(chain):
    """Return the arm with wrist axes that do not intersect."""
    step = next(step for step in chain.joints_to() if step.joint.name == chain.names[4])
    origin = step.joint.origin.copy()
    origin[:3, 3] += (0.0, 0.02, 0.01)
    return chain.with_origins({step.joint.name: origin})


def test_preferred_posture_has_priority_over_nearest_option():
    chain, target, q0 = next(questions("so101", "position", 1))

    preferred = chain.mid_range() + 0.3
    leaning = solve(chain, target, q0, posture=Posture(preferred, np.ones(chain.dof)))
    assert way(leaning.q, preferred) < way(solve(chain, target, q0).q, preferred)


def test_solve_option_nearest_must_be_a_bool():
    chain, target, q0 = next(questions("so101", "position", 1))
    with pytest.raises(BadValueError, match="nearest"):
        solve(chain, target, q0, nearest="no")


def test_nearest_closed_form_solution_has_trace_from_start():
    for chain, target, q0 in questions("wx250s", "pose", 30):
        result = solve(chain, target, q0, trace=True)
        if result.method == "closed_form":
            np.testing.assert_array_equal(result.trace[-1], result.q)
            np.testing.assert_array_equal(result.trace[0], chain.clip(q0))
            return
    raise AssertionError("none was exchanged")


def test_tracking_stops_at_limit_instead_of_jumping_branch():
    # The first half of the line of poses of docs/benchmarks.md that ours does not follow.
    chain = load_model("vx300s").chain
    q = np.array([-0.40295758, -1.29302554, -1.63821139, 1.68671205, -1.52494954, 0.9037118])
    elbow = chain.names.index("elbow")
    beyond = q.copy()
    beyond[elbow] = chain.lower_rad[elbow] - 0.05
    T = chain.forward(beyond)
    solver = Solver(chain, "pose")
    followed, reached = solver.track(T, q)
    assert not reached
    assert [str(limit) for limit in solver.result.binding] == ["elbow at its lower limit"]
    assert np.abs(followed - q).max() < 0.3
    result = solve(chain, Target(T[:3, 3], orientation=T[:3, :3]), q)
    assert result.reached
    assert np.degrees(np.abs(result.q - q).max()) > 30.0

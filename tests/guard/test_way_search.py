"""The path search: a ball on two slides, behind a wall with a gap."""

import numpy as np
import pytest

from ikservo.guard import CollisionChecker, KeepOutBox, path_search
from ikservo.guard.path_search import WaySearch, path_length
from ikservo.kernels import compiled
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from tests.both_ways import needs_extension
from tests.kinematics.chains import joint

START, GOAL = np.array([0.1, 0.1]), np.array([0.9, 0.1])
SIDES = np.zeros(2), np.ones(2)
RADIUS_M = 0.02


def maze(gap=0.9, half_m=0.15, margin_m=0.01):
    """Return the free space of a ball beside a wall at x = 0.5 with a gap."""
    joints = [
        joint("x", JointType.PRISMATIC, "base", "cart", (0, 0, 0), (1, 0, 0), lower=0.0, upper=1.0),
        joint("y", JointType.PRISMATIC, "cart", "tip", (0, 0, 0), (0, 1, 0), lower=0.0, upper=1.0),
    ]
    chain = Chain.from_joints(joints, "base", "tip")
    body = CollisionBody(chain, [Capsule("tip", np.zeros(3), np.zeros(3), RADIUS_M)])
    walls = [
        KeepOutBox("below", (0.46, -1.0, -0.1), (0.54, gap - half_m, 0.1)),
        KeepOutBox("above", (0.46, gap + half_m, -0.1), (0.54, 9.0, 0.1)),
    ]
    return CollisionChecker(body, None, walls).clear_space(margin_m, np.array([START]), load=0.0)


def search(space, goals=(GOAL,), **options):
    return WaySearch(space, START, np.array(goals), *SIDES, **options)


def test_path_search_finds_gap_to_reachable_goal():
    goals, most = [GOAL, [0.5, 0.2], [0.9, 1.9]], 20000
    way = search(maze(), goals).find(most)
    assert maze().is_free(way)
    np.testing.assert_array_equal(way[[0, -1]], [START, GOAL])
    assert 1.6 < path_length(way) < 2.0
    np.testing.assert_array_equal(way, search(maze(), goals).find(most))


def test_path_search_resumes_where_it_was_interrupted():
    parts = search(maze())
    found = [parts.find(10) for _ in range(200)]
    way = next(way for way in found if way is not None)
    np.testing.assert_array_equal(way[[0, -1]], [START, GOAL])
    assert parts.has_ended
    assert parts.find(1000) is None


def test_path_search_with_blocked_start_or_goal_ends_at_once():
    assert search(maze(), [[0.5, 0.2]]).has_ended
    assert search(maze(), [[0.9, 1.9]]).has_ended
    assert search(maze(), [[0.5, 0.2]]).find(100) is None


def test_path_search_ends_by_callback_or_sample_limit():
    walled, asked = search(maze(gap=5.0)), []

    def ends_at_the_third():
        asked.append(True)
        return len(asked) > 2

    assert walled.find(10**9, ends_at_the_third) is None
    assert walled.find(3000) is None
    assert not walled.has_ended


def test_path_search_ends_once_its_trees_are_full(monkeypatch):
    monkeypatch.setattr(path_search, "_NODES", 60)
    walled = search(maze(gap=5.0))
    assert walled.find(10**6) is None
    assert walled.has_ended


def test_path_search_does_not_jump_through_thin_wall(monkeypatch):
    thin = maze(gap=5.0)  # the wall is 80 mm thick, as is the ball with what it keeps
    monkeypatch.setattr(path_search, "_STEP_M", 0.5)
    walled = search(thin)
    assert walled.find(20000) is None
    assert walled._step_m < 0.5


def test_path_search_shortens_path_after_finding_first(monkeypatch):
    space = maze(gap=0.6, half_m=0.06)
    lengths = [path_length(search(space, seed=seed).find(20000)) for seed in range(1, 9)]
    monkeypatch.setattr(path_search, "_MOST_WAYS", 1)
    first = [path_length(search(space, seed=seed).find(20000)) for seed in range(1, 9)]
    assert sum(lengths) <= sum(first)
    assert max(lengths) < 1.25 * min(lengths)


def test_path_search_shortens_path_until_time_is_up():
    asked = []

    def is_over():
        asked.append(True)
        return len(asked) > 40

    space = maze(gap=0.6, half_m=0.06)
    lengths = [path_length(search(space, seed=seed).find(20000)) for seed in range(1, 9)]
    for seed in range(1, 4):
        asked.clear()
        way = search(space, seed=seed, takes_time=True).find(20000, is_over)
        assert len(asked) > 40
        assert space.is_free(way)
        assert path_length(way) < 1.05 * min(lengths)


@needs_extension
@pytest.mark.parametrize("name", ["grow_trees", "shorten_way"])
def test_compiled_path_search_equals_python_search(monkeypatch, name):
    pairs = []

    def bind(asked, *arguments):
        both = compiled.bind(asked, *arguments)
        if asked != name:
            return both
        copies = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]
        for one, copy in zip(arguments, copies, strict=True):
            if isinstance(one, np.ndarray) and one.base is None:
                copy[...] = one

        def run(*others):
            for one, copy in zip(arguments, copies, strict=True):
                if isinstance(one, np.ndarray):
                    copy[...] = one
            found = both(*others)
            assert compiled.uncompiled[name](*copies, *others) == found
            for one, copy in zip(arguments, copies, strict=True):
                np.testing.assert_array_equal(one, copy)
            pairs.append(name)
            return found

        return run

    monkeypatch.setattr(path_search, "bind", bind)
    monkeypatch.setattr(path_search, "_NODES", 200)
    monkeypatch.setattr(path_search, "_MOST_WAYS", 1)
    assert search(maze(gap=0.8, half_m=0.1)).find(500) is not None
    assert pairs


@pytest.mark.parametrize("hit", range(3))
def test_path_search_does_not_depend_on_previous_contact(hit):
    others = search(maze())
    others._state[others._kernel.HIT] = hit  # the numbers of its three links
    np.testing.assert_array_equal(others.find(20000), search(maze()).find(20000))
    assert others._state[others._kernel.HIT] == 2  # only the ball can touch the walls

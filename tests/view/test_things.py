"""The things around an arm on its page: added, changed, dragged, removed, saved."""

from dataclasses import replace

import numpy as np
import pytest

from ikservo.errors import CollisionError
from ikservo.model.scene import read_scene
from ikservo.view import thing_messages as things
from ikservo.view.auth import Permission
from ikservo.view.messages import BadMessageError
from tests.view.view_session import ViewSession

DRAG_PX = 60.0


@pytest.fixture
def session():
    with ViewSession() as made:
        yield made


def shown(session, client=None):
    """Return the things that a client is sent, by name."""
    frame = session.latest_frames(client).get("things", {"things": []})
    return {each["name"]: each for each in frame["things"]}


def test_a_thing_is_added_changed_renamed_and_removed(session):
    session.latest_frames()
    session.send_message(things.AddThing, shape="box")
    assert set(shown(session)) == {"the box 1"}
    session.send_message(things.ChangeThing, name="the box 1", centre_m=(0.2, 0.15, 0.12))
    session.send_message(
        things.ChangeThing, name="the box 1", new_name="the shelf", size_m=(0.1, 0.1, 0.02)
    )
    (shelf,) = shown(session).values()
    assert shelf["name"] == "the shelf"
    assert shelf["half"] == pytest.approx((0.05, 0.05, 0.01))
    assert shelf["sizes"]["centre_m"] == pytest.approx((0.2, 0.15, 0.12))
    with pytest.raises(CollisionError, match="the shelf"):
        session.arm.plan_to((0.2, 0.15, 0.12), straight=True)
    session.send_message(things.RemoveThing, name="the shelf")
    assert session.arm.scene.names == ()
    assert session.arm.plan_to((0.2, 0.15, 0.12), straight=True).solution.reached


@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere"])
def test_new_things_have_names_of_their_own_and_touch_nothing(session, shape):
    for _ in range(2):
        session.send_message(things.AddThing, shape=shape)
    first, second = session.arm.scene.names
    assert first[:-1] == second[:-1]
    assert session.arm.clearance_m(session.arm.where().positions) > 0.0


def test_there_is_an_end_to_adding(session):
    session.send_message(things.AddThing, shape="sphere")
    (ball,) = session.arm.scene.things
    more = {f"ball {i}": replace(ball, name=f"ball {i}") for i in range(100)}
    session.arm.scene._change(more, {})
    with pytest.raises(BadMessageError, match="below 100"):
        session.send_message(things.AddThing, shape="sphere")


def test_what_has_not_changed_is_sent_once(session):
    session.send_message(things.AddThing, shape="sphere")
    assert shown(session)
    assert "things" not in session.latest_frames()
    watcher = session.connect(Permission.WATCH)
    assert shown(session, watcher)


@pytest.mark.parametrize(
    ("message", "fields", "sentence"),
    [
        (things.ChangeThing, {"name": "the cup", "radius_m": 0.1}, "no thing named 'the cup'"),
        (things.ChangeThing, {"name": "the ball 1", "radius_m": -0.1}, "radius_m"),
        (things.ChangeThing, {"name": "the ball 1", "size_m": (0.1, 0.1, 0.1)}, "size_m"),
        (things.ChangeThing, {"name": "the ball 1", "new_name": "base"}, "not taken"),
        (things.ChangeThing, {"name": "the ball 1", "new_name": "a\nb"}, "name"),
        (things.RemoveThing, {"name": "the cup"}, "no thing named 'the cup'"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(session, message, fields, sentence):
    session.send_message(things.AddThing, shape="sphere")
    (before,) = session.arm.scene.things
    with pytest.raises(BadMessageError, match=sentence):
        session.send_message(message, **fields)
    assert session.arm.scene.things == (before,)


def test_nothing_changes_while_the_arm_follows_or_for_who_only_watches(session):
    watcher = session.connect(Permission.WATCH)
    with pytest.raises(BadMessageError, match="for watching only"):
        session.send_message(things.AddThing, watcher, shape="box")
    session.enable_live()
    with pytest.raises(BadMessageError, match="Things stay while the arm follows"):
        session.send_message(things.AddThing, shape="box")
    assert session.arm.scene.names == ()


def test_a_thing_is_dragged_and_stands_where_it_was_dropped(session):
    session.send_message(things.AddThing, shape="box")
    session.send_message(things.ChangeThing, name="the box 1", centre_m=(0.1, 0.25, 0.03))
    at = session.camera().project(np.array([0.1, 0.25, 0.03]))[0].tolist()
    session.point("down", *at)
    for part in (0.5, 1.0):
        session.point("move", at[0] + part * DRAG_PX, at[1])
    before_m = np.reshape(shown(session)["the box 1"]["pose"], (4, 4))[:3, 3]
    (stands,) = session.arm.scene.things
    assert np.linalg.norm(before_m - stands.row[9:12]) > 0.02  # drawn there, not moved yet
    session.point("up", at[0] + DRAG_PX, at[1])
    (moved,) = session.arm.scene.things
    np.testing.assert_allclose(moved.row[9:12], before_m, atol=1e-9)
    session.point("hover", *at)
    assert session.arm.scene.things == (moved,)


def test_they_are_saved_as_a_scene_file(session, tmp_path):
    for shape in ("box", "cylinder", "sphere"):
        session.send_message(things.AddThing, shape=shape)
    session.send_message(things.SaveThings)
    offer = session.latest_frames()["download"]
    assert offer["name"] == "scene.toml"
    (download,) = [each for _, each in session.controller.downloads._offers.values()]
    (tmp_path / "scene.toml").write_text("".join(download.make()), encoding="utf-8")
    assert [each.name for each in read_scene(tmp_path / "scene.toml")] == list(
        session.arm.scene.names
    )

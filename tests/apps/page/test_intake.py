"""Messages of a connection: bounds of every field, order, age and rate."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.apps.page.messages.page_messages import (
    MAX_MESSAGE_BYTES,
    BadMessageError,
    Stop,
    read_message,
)
from ikservo.apps.page.server.message_age_and_rate import (
    MAX_MESSAGE_AGE_S,
    MessageFilter,
    RateLimitError,
    StaleMessageError,
    StalePressError,
)

POINTER = {"kind": "pointer", "phase": "down", "x": 1, "y": 2, "button": 0, "pointer": 1}


def text(seq=1, seen=0, **fields):
    return json.dumps({**{"kind": "stop", "seq": seq, "seen": seen}, **fields})


@pytest.fixture
def intake():
    return MessageFilter(0.0, read_message)


def test_page_messages_in_order_are_accepted(intake):
    assert [intake.accept(text(seq), 0.0).seq for seq in (1, 2, 5)] == [1, 2, 5]


@pytest.mark.parametrize("seq", [1, 2])
def test_replayed_page_message_is_refused(intake, seq):
    intake.accept(text(2), 0.0)
    with pytest.raises(BadMessageError, match="was received before"):
        intake.accept(text(seq), 0.0)


def test_page_message_about_outdated_scene_is_refused(intake):
    intake.record_sent(0.0)
    intake.record_sent(0.1)
    with pytest.raises(BadMessageError, match="1 s old"):
        intake.accept(text(1, 1, **POINTER), 0.1 + MAX_MESSAGE_AGE_S + 0.01)


def test_page_with_high_latency_is_not_disconnected(intake):
    intake.record_sent(0.0)
    for seq in range(1, 100):
        with pytest.raises(StaleMessageError):
            intake.accept(text(seq, 0, **POINTER), 9.0 + seq)


@pytest.mark.parametrize(
    "press",
    [
        POINTER | {"phase": "down"},
        {"kind": "drag_tool", "phase": "down"},
        {"kind": "change_thing", "name": "the box 1", "radius_m": 0.1},
        {"kind": "go_to_pose", "name": "home"},
    ],
)
def test_press_on_outdated_view_is_reported_to_user(intake, press):
    intake.record_sent(0.0)
    with pytest.raises(StalePressError, match="more than 1 s old, so nothing was done"):
        intake.accept(text(1, 0, **press), 9.0)


@pytest.mark.parametrize("phase", ["hover", "move", "up"])
def test_pointer_motion_on_outdated_view_is_dropped_silently(intake, phase):
    intake.record_sent(0.0)
    with pytest.raises(StaleMessageError) as caught:
        intake.accept(text(1, 0, **POINTER | {"phase": phase}), 9.0)
    assert not isinstance(caught.value, StalePressError)


def test_late_page_hidden_message_is_accepted(intake):
    intake.record_sent(0.0)
    assert not intake.accept(text(1, kind="heartbeat", visible=False), 9.0).visible


def test_late_viewport_size_is_accepted(intake):
    intake.record_sent(0.0)
    view_state = {"kind": "viewport", "w": 640, "h": 480, "dpr": 1.0, "view": "side"}
    assert intake.accept(text(1, **view_state), 9.0).h == 480


def test_late_stop_message_is_accepted(intake):
    intake.record_sent(0.0)
    intake.record_sent(0.1)
    assert isinstance(intake.accept(text(1, 1), 9.0), Stop)


def test_page_message_about_latest_scene_is_never_outdated(intake):
    intake.record_sent(0.0)
    assert intake.accept(text(1, 1, **POINTER), 9.0).x == 1


def test_page_message_about_scene_not_yet_sent_is_refused(intake):
    with pytest.raises(BadMessageError, match="never sent"):
        intake.accept(text(1, 7), 0.0)


def taken(intake, words):
    """Return how many of the messages are accepted before the connection must be closed."""
    for count, message in enumerate(words):
        try:
            intake.accept(message, 0.0)
        except RateLimitError:
            return count
        except BadMessageError:
            continue
    return math.inf


def test_message_flood_ends_connection_after_200(intake):
    assert taken(intake, map(text, range(1, 10_000))) == 200


def test_300_messages_per_second_are_accepted(intake):
    for seq in range(1, 3000):  # 300 a second for 10 s
        intake.accept(text(seq), seq / 300)


def test_twenty_invalid_messages_end_page_connection(intake):
    assert taken(intake, ["{"] * 100) == 20


MALFORMED = [
    "", "{", "null", "[]", "1", '"stop"', "{}", '{"kind":"stop"}', "\ud800",
    text(kind="fly"), text(kind=None), text(kind=["stop"]), text(extra=1),
    text(seq=0), text(seq=-1), text(seq=1.5), text(seq="1"), text(seq=True), text(seq=2**60),
    text(seen=-1), text(seen=None), text(**{**POINTER, "x": "1"}), text(**{**POINTER, "x": 1e9}),
    text(**{**POINTER, "x": None}), text(**{**POINTER, "phase": "fly"}),
    text(**{**POINTER, "button": 9}), text(**{**POINTER, "shift": 1}),
    text(**POINTER).replace('"x": 1', '"x": NaN'), text(**POINTER).replace('"x": 1', '"x": 1e999'),
    text(**POINTER).replace('"x": 1', '"x": Infinity'), text(kind="set_live", on="yes"),
    text(kind="viewport", w=0, h=1, dpr=1, view="side"),
    text(kind="viewport", w=64, h=64, dpr=1, view="x"),
    text(kind="gamepad", axes=[0, 0, 0]), text(kind="gamepad", axes=[0, 0, 0, 2]),
    text(kind="go_to_pose", name="../rest"), text(kind="go_to_pose", name="x" * 65),
    text(kind="set_speed", name="warp"),
    text(kind="calibration", action="burn"), text(kind="wheel", x=1, y=1, notches=1e6),
    text(pad="x" * MAX_MESSAGE_BYTES), "[" * 1500, '{"a":' * 300,
]  # fmt: skip


@pytest.mark.parametrize("words", MALFORMED)
def test_a_malformed_message_is_refused(intake, words):
    with pytest.raises(BadMessageError):
        intake.accept(words, 0.0)


def test_refused_message_does_not_use_up_sequence_number(intake):
    with pytest.raises(BadMessageError):
        intake.accept(text(1, kind="fly"), 0.0)
    assert intake.accept(text(1), 0.0).seq == 1


@given(st.text(max_size=200) | st.binary(max_size=200).map(lambda b: b.decode("latin-1")))
def test_random_message_text_raises_only_refusal(words):
    with pytest.raises(BadMessageError):
        MessageFilter(0.0, read_message).accept(words, 0.0)

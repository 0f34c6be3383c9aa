"""Texts of the page beside the picture: numbers with units, in the words of the commands."""

from dataclasses import replace

import numpy as np
import pytest

from ikservo.apps.page.dragging.labels import (
    condition_rows,
    describe_target,
    format_solve_time,
    format_supply,
    health_rows,
)
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.page_updates import _joint_meter_fields
from ikservo.arm import JointState
from ikservo.errors import format_point
from ikservo.ik import ActiveLimit
from ikservo.model import load_model
from ikservo.model.arm_model import HealthLimits

TIP = np.array([0.2, 0.0, 0.15])


def test_unreachable_target_text_equals_that_of_command_line():
    aim = TargetMarker(
        TIP + np.array([0.5, 0, 0]),
        TIP,
        reached=False,
        binding=(ActiveLimit("elbow_flex", "upper"),),
    )
    assert describe_target(aim) == (
        "(0.700, 0.000, 0.150) m cannot be reached (elbow_flex at its upper limit). "
        "Nearest reachable point: (0.200, 0.000, 0.150) m, 500.0 mm away."
    )


@pytest.mark.parametrize(
    ("volts", "words"), [((7.41, 7.38), "7.4 V"), ((5.0, 12.04), "5.0 – 12.0 V")]
)
def test_supply_voltage_is_shown_as_range_only_if_servos_differ(volts, words):
    assert format_supply(volts) == words


def test_page_shows_points_and_times_with_units():
    assert format_point(TIP) == "(0.200, 0.000, 0.150) m"
    assert format_solve_time(0.000042) == "0.04 ms"


@pytest.mark.parametrize(
    ("messages", "level"),
    [({}, "good"), ({"temperature_c": 61.0}, "amber"), ({"load_percent": -85.0}, "amber"),
     ({"temperature_c": 66.0}, "red"), ({"alarms": ("overload",)}, "red")],
)  # fmt: skip
def test_servo_health_level_depends_on_heat_load_and_alarms(messages, level):
    state = JointState("elbow_flex", 0.0, -1.0, 1.0, "arm file", 31.0, 12.1, None, torque=True)
    assert health_rows([replace(state, **messages)], HealthLimits())[0]["level"] == level


@pytest.mark.parametrize(("celsius", "level"), [(39.0, "good"), (41.0, "amber"), (46.0, "red")])
def test_servo_health_levels_follow_limits_of_arm(celsius, level):
    state = JointState("elbow_flex", 0.0, -1.0, 1.0, "arm file", celsius, 12.1, 4.0, torque=True)
    limits = HealthLimits(warn_c=40.0, hold_c=45.0, release_c=50.0)
    assert health_rows([state], limits)[0]["level"] == level


def test_health_values_are_shown_with_units():
    state = JointState("elbow_flex", 0.0, -1.0, 1.0, "arm file", 31.0, 12.1, 4.0, torque=True)
    row = health_rows([state], HealthLimits())[0]
    assert (row["temperature"], row["voltage"], row["load"]) == ("31 °C", "12.1 V", "4 %")


@pytest.mark.parametrize(("torque", "past"), [(True, "beyond"), (False, "near")])
def test_joint_beyond_limit_is_marked_if_torque_is_on(torque, past):
    model = load_model("so101")

    def nearness(at):
        state = JointState("elbow_flex", at, -1.0, 1.0, "arm file", 25.0, 7.4, None, torque=torque)
        return _joint_meter_fields(model, state, at, at)["state"]

    assert [nearness(at) for at in (0.0, -1.0, 1.0, -1.2)] == ["", "near", "near", past]


def test_servo_alarms_with_same_cause_share_one_row():
    state = JointState("pan", 0.0, -1.0, 1.0, "arm file", 31.0, 12.1, 4.0, torque=True)
    alarms = {
        "pan": ("input voltage",),
        "lift": ("input voltage",),
        "elbow": ("too hot",),
        "roll": (),
    }
    states = [replace(state, name=name, alarms=each) for name, each in alarms.items()]
    rows = condition_rows(states, None, HealthLimits())
    assert rows[-2:] == [("pan, lift", "input voltage", "bad"), ("elbow", "too hot", "bad")]

"""The history of ten minutes: bounded, complete, in the units of the page."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest

from ikservo.apps.page.dragging.snapshot import ArmSnapshot
from ikservo.apps.page.messages.page_messages import BadMessageError, ShowPlots
from ikservo.apps.page.panels.live_plots import PlotFeed
from ikservo.apps.page.running.history import Channel, History, csv_lines
from ikservo.arm import JointState
from ikservo.hardware.servo import LinkStatistics, ServoStatistics

LINK = LinkStatistics(lost=3, round_trip_s=0.0025)


def state(name, **fields):
    usual = JointState(name, 0.0, -1.0, 1.0, "arm file", 31.0, 12.1, -4.0, torque=True)
    return replace(usual, **fields)


def snapshot(at=0.1, goal=None, **fields):
    states = (state("pan", **fields), state("slide"))
    reference = None if goal is None else np.array([goal, 0.02])
    return ArmSnapshot(*2 * [np.array([at, 0.01])], reference=reference, states=states)


def make_history(**options):
    return History(["pan", "slide"], [False, True], **options)


def column(history, quantity, joint="pan"):
    (channel,) = [c for c in history.channels if (c.quantity, c.joint) == (quantity, joint)]
    return history.since(-math.inf).select([channel])[:, 0].tolist()


def fill(history, count, step_s=0.02, **fields):
    for row in range(count):
        history.record(snapshot(at=0.001 * row, **fields), LINK, row * step_s)
    return history


def test_telemetry_history_uses_degrees_and_millimetres():
    history = make_history()
    history.record(snapshot(at=math.radians(30), goal=math.radians(32)), LINK, 0.0)
    assert column(history, "position") == pytest.approx([30.0])
    assert column(history, "goal") == pytest.approx([32.0])
    assert column(history, "error") == pytest.approx([2.0], abs=1e-4)
    assert column(history, "error", "slide") == pytest.approx([10.0])


def test_telemetry_history_distinguishes_missing_value_from_zero():
    history = make_history()
    history.record(snapshot(load_percent=None), LinkStatistics(0, None), 0.0)
    for quantity in ("goal", "error", "load", "current"):
        assert math.isnan(column(history, quantity)[0])
    assert math.isnan(column(history, "round_trip", "")[0])
    assert column(history, "losses", "") == [0.0]


def test_history_keeps_telemetry_and_link_statistics():
    history = make_history()
    history.record(snapshot(current_a=0.25), LINK, 0.0)
    values = {q: column(history, q)[0] for q in ("load", "current", "temperature", "voltage")}
    assert values == pytest.approx(
        {"load": -4, "current": 0.25, "temperature": 31, "voltage": 12.1}
    )
    assert column(history, "round_trip", "") == pytest.approx([2.5])


def test_history_drops_samples_closer_than_20_ms():
    history = fill(make_history(), 100, step_s=0.005)
    assert np.diff(history.since(-math.inf).times_s).min() >= 0.0199


def size_bytes(history):
    return history._times.nbytes + history._values.nbytes


def test_history_memory_is_constant_and_drops_oldest_samples():
    history = make_history(duration_s=1.0)
    before = size_bytes(history)
    fill(history, 1000)
    times = history.since(-math.inf).times_s
    assert size_bytes(history) == before
    assert times[-1] == pytest.approx(999 * 0.02)
    assert 1.0 <= times[-1] - times[0] < 1.1
    assert (np.diff(times) > 0).all()


def test_history_of_seven_joints_stays_below_10_mb():
    history = History([f"joint{i}" for i in range(7)], [False] * 7)
    assert size_bytes(history) < 10e6


def test_telemetry_history_query_returns_only_newer_samples():
    history = fill(make_history(), 50)
    assert history.since(0.9).times_s.tolist() == pytest.approx([0.92, 0.94, 0.96, 0.98])
    assert len(history.since(5.0).times_s) == 0


def test_history_drops_samples_overwritten_during_read(monkeypatch):
    history = fill(make_history(duration_s=1.0), 54)
    search = np.searchsorted

    def overtake(*args, **options):
        for row in range(54, 64):
            history.record(snapshot(), LINK, row * 0.02)
        return search(*args, **options)

    monkeypatch.setattr("ikservo.apps.page.running.history.np.searchsorted", overtake)
    times = history.since(-math.inf).times_s
    assert times[0] == pytest.approx(11 * 0.02)
    assert (np.diff(times) > 0).all()


def test_history_keeps_ten_seconds_before_stop():
    history = fill(make_history(), 1000)
    lost = LinkStatistics(lost=6, round_trip_s=0.02)  # by the cycle that failed
    history.mark_stop("shoulder hit something", snapshot(), lost, 999 * 0.02 + 0.01)
    fill(history, 2000)
    stop = history.last_stop
    assert stop.reason == "shoulder hit something"
    assert stop.select([Channel("losses", "")])[-2:, 0].tolist() == [3.0, 6.0]
    assert stop.times_s[-1] - stop.times_s[0] == pytest.approx(10.0, abs=0.03)


def test_history_csv_names_units_and_leaves_unmeasured_empty():
    history = fill(make_history(), 250)
    rows = list(csv.DictReader("".join(csv_lines(history.since(-math.inf))).splitlines()))
    assert len(rows) == 250
    assert rows[100]["time_s"] == "2.000"
    assert float(rows[100]["pan_position_deg"]) == pytest.approx(math.degrees(0.1), rel=1e-5)
    assert rows[100]["slide_position_mm"] == "10"
    assert rows[100]["pan_goal_deg"] == ""
    assert rows[100]["losses"] == "3"
    assert len(rows[0]) == 1 + len(history.channels)


def test_link_statistics_sum_over_servos():
    one, other = ServoStatistics(lost=2, garbled=1), ServoStatistics(lost=4)
    one.round_trips_s.extend([0.5, 0.001])
    other.round_trips_s.append(0.003)
    assert LinkStatistics.of([one, other]) == LinkStatistics(7, 0.003)
    assert LinkStatistics.of([ServoStatistics()]).round_trip_s is None


def chosen(*quantities, joints=("pan",), **fields):
    return ShowPlots(
        kind="show_plots", seq=1, seen=0, quantities=list(quantities), joints=list(joints), **fields
    )


def test_closed_plots_do_not_send_frames():
    history, feed = fill(make_history(), 100), PlotFeed()
    assert feed.frames(1, history, 2.0) == []
    feed.choose(1, chosen("position"), history)
    assert feed.frames(1, history, 2.0)
    feed.choose(1, chosen(), history)
    assert feed.frames(1, history, 3.0) == []


def test_plots_send_history_first_then_5_updates_per_second():
    history, feed = fill(make_history(), 500), PlotFeed()
    feed.choose(1, chosen("position", "round_trip", span_s=1), history)
    (first,) = feed.frames(1, history, 9.98)
    assert first["series"] == [
        {"quantity": "position", "unit": "°", "joint": "pan"},
        {"quantity": "round_trip", "unit": "ms", "joint": ""},
    ]
    assert first["times"][0] == pytest.approx(9.0)
    assert feed.frames(1, history, 10.1) == []
    history.record(snapshot(at=math.radians(5)), LINK, 10.0)
    (later,) = feed.frames(1, history, 10.2)
    assert (later["times"], later["values"]) == ([10.0], [[5.0], [2.5]])
    assert "series" not in later


@pytest.mark.full
def test_ten_minute_plot_is_thinned_to_about_600_samples():
    history, feed = fill(make_history(), 31000), PlotFeed()
    feed.choose(1, chosen("position", span_s=600), history)
    (first,) = feed.frames(1, history, 620.0)
    assert 590 <= len(first["times"]) <= 601


def test_plot_of_stop_is_sent_once_with_stop_reason():
    history, feed = fill(make_history(), 100), PlotFeed()
    history.mark_stop("low supply", snapshot(), LINK, 2.0)
    feed.choose(1, chosen("goal", stopped=True), history)
    (frame,) = feed.frames(1, history, 2.0)
    assert frame["reason"] == "low supply"
    assert frame["values"] == [[None] * 101]
    assert feed.frames(1, history, 3.0) == []


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (chosen("position", joints=["nose"]), "no joint 'nose'"),
        (chosen("position", stopped=True), "Nothing has stopped"),
    ],
)
def test_plot_of_unknown_joint_or_missing_stop_is_refused(message, words):
    with pytest.raises(BadMessageError, match=words):
        PlotFeed().choose(1, message, make_history())


def test_bus_statistics_channels_belong_to_no_joint():
    assert make_history().channels[-2:] == (Channel("round_trip", "ms"), Channel("losses", ""))

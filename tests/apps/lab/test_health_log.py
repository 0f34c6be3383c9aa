"""Wear of servos is told apart from noise, damaged files and other changes."""

import json
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from ikservo.apps.lab.health_log import (
    MAX_RECORDS,
    HealthRecord,
    JointHealth,
    append_record,
    changes_of,
    health_path,
    latest_health,
    measure_health,
    read_records,
)
from ikservo.errors import FileFormatError
from tests.hardware.factories import make_bus

DAY = datetime(2026, 3, 2, tzinfo=UTC)
JOINTS = ("pan", "lift", "elbow", "wrist", "roll", "gripper")


def record(day, plays_deg, frictions=None, error_deg=0.08):
    frictions = dict.fromkeys(plays_deg, 0.05) if frictions is None else frictions
    joints = tuple(
        JointHealth(
            name=name, id=i + 1, backlash_rad=float(np.radians(play)),
            backlash_error_rad=float(np.radians(error_deg)),
            friction_nm=float(frictions[name]), friction_error_nm=0.004,
        )
        for i, (name, play) in enumerate(plays_deg.items())
    )  # fmt: skip
    return HealthRecord(written=DAY + timedelta(days=day), source="identify", joints=joints)


def history(random, true_deg, days, wear_deg=None, noise_deg=0.08):
    """Return the records of an arm whose last measurement was taken after some wear."""
    for day in days:
        worn = wear_deg if day == days[-1] and wear_deg else {}
        plays = {n: true_deg[n] + worn.get(n, 0.0) + random.normal(0, noise_deg) for n in JOINTS}
        frictions = {n: 0.05 * (1 + random.normal(0, 0.08)) for n in JOINTS}
        yield record(day, {n: max(p, 0.0) for n, p in plays.items()}, frictions)


def test_health_comparison_names_joint_whose_backlash_grew():
    random = np.random.default_rng(3)
    found = 0
    for _ in range(100):
        true_deg = {name: random.uniform(0.3, 1.0) for name in JOINTS}
        records = list(history(random, true_deg, (0, 40, 90), {"elbow": 0.6}))
        changes = changes_of(records)
        found += [(c.joint, c.key) for c in changes] == [("elbow", "backlash_rad")]
    assert found >= 95


def test_repeated_health_checks_without_wear_give_no_warning():
    random = np.random.default_rng(4)
    alarms = 0
    for _ in range(200):
        true_deg = {name: random.uniform(0.2, 2.0) for name in JOINTS}
        alarms += bool(changes_of(list(history(random, true_deg, (0, 10, 20, 30)))))
    assert alarms <= 4


def test_heat_voltage_and_lost_replies_are_not_reported_as_wear():
    calm = JointHealth(name="pan", id=1, temperature_c=25.0, voltage_v=7.4, load=0.1, requests=20)
    hot = JointHealth(name="pan", id=1, temperature_c=60.0, voltage_v=6.1, load=0.9, lost=9)
    records = [HealthRecord(written=DAY, source="monitor", joints=(each,)) for each in (calm, hot)]
    assert changes_of(records) == []
    (latest,) = latest_health(records)
    assert (latest.temperature_c, latest.requests, latest.lost) == (60.0, 20, 9)


def test_health_records_round_trip_and_keep_damaged_file(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    path = health_path("so101", "58FA/../083")
    assert path.parent == tmp_path / "health"
    written = [record(day, dict.fromkeys(JOINTS, 0.5)) for day in range(3)]
    for each in written:
        append_record(path, each)
    assert read_records(path) == written
    for damage in ("{", "[]", '{"format": 2}', "NaN", "[" * 5000, json.dumps({"format": 1})):
        path.write_text(path.read_text() + damage + "\n")
        before = path.read_bytes()
        with pytest.raises(FileFormatError, match=r"so101-58FA____083\.jsonl"):
            append_record(path, written[0])
        assert path.read_bytes() == before
        path.write_text("".join(f"{each.model_dump_json(exclude_none=True)}\n" for each in written))


def test_concurrent_appends_do_not_lose_health_records(tmp_path):
    """Threads act as programs: the lock excludes everyone who opens the file separately."""
    path = tmp_path / "health" / "arm.jsonl"
    records = [record(day, {"pan": 0.5}) for day in range(75)]
    with ThreadPoolExecutor(3) as programs:
        list(programs.map(lambda each: append_record(path, each), records))
    assert sorted(read_records(path), key=lambda each: each.written) == records


def test_full_health_log_drops_oldest_record(tmp_path):
    path = tmp_path / "arm.jsonl"
    one = HealthRecord(written=DAY, source="monitor", joints=())
    path.write_text(f"{one.model_dump_json()}\n" * MAX_RECORDS)
    append_record(path, record(5, dict.fromkeys(JOINTS, 0.5)))
    records = read_records(path)
    assert (len(records), records[-1].written) == (MAX_RECORDS, DAY + timedelta(days=5))


def test_measure_health_reads_every_servo():
    bus = make_bus({1: "STS3215", 7: "XL430-W250"})
    joints = measure_health(bus, 0.5)
    assert [joint.id for joint in joints] == [1, 7]
    assert all(joint.temperature_c and joint.voltage_v and not joint.lost for joint in joints)

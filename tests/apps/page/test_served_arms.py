"""Several arms of one page are opened, stopped and closed separately, and fail alone."""

import json
from contextlib import contextmanager

import pytest

from ikservo.apps.page import arm_choices
from ikservo.apps.page.arm_choices import ChoiceFinder, find_choices
from ikservo.apps.page.arm_list import ArmList, read_arm_list_message
from ikservo.apps.page.messages.page_messages import BadMessageError, SetLive, SetSpeed
from ikservo.apps.page.served_arms import ArmAtPort, ServedArms, ViewSettings
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.apps.page.server.server import SessionEndedError
from ikservo.arm import open_arm
from ikservo.calibration.paths import calibration_path
from ikservo.clock import RealClock
from ikservo.hardware.serial_ports import SerialAdapter
from ikservo.model import load_model
from tests.arm.simulated import line_of, registers
from tests.browser.page_operator import until

NOT_THERE = "/dev/ttyNOTHERE"
SILENT_S = 60.0  # longer than a test that goes live and sends no heartbeats


@contextmanager
def served(*places):
    clock = RealClock()
    offers = DownloadOffers(clock)
    arms = ServedArms(ViewSettings(open_arm, clock, offers, SILENT_S))
    try:
        arms.open_all([ArmAtPort(load_model(arm), port) for arm, port in places])
        yield arms, ArmList(arms, ChoiceFinder([]), clock, offers)
    finally:
        arms.close()


@pytest.fixture
def two_arms():
    """Two simulated arms that hold, and a client of the list who may move them."""
    with served(("so101", "sim:?pose=home"), ("koch", "sim:?pose=home")) as (arms, listed):
        for arm in arms.all():
            arm.arm_thread.arm.enable()
        yield arms, listed


def said(listed, client):
    """Return the arms in the present list, by name."""
    listed._sent.clear()
    (frame,) = listed.frames(client)
    return {row["name"]: row for row in frame["arms"]}


def tell(listed, client, kind, **fields):
    words = {"kind": kind, "seq": 1, "seen": 0, **fields}
    listed.receive(client, read_arm_list_message(json.dumps(words)))


def live(arm):
    """Switch an arm to Live from a page."""
    page = arm.connect(Permission.CONTROL)
    arm.receive(page, SetSpeed(kind="set_speed", seq=1, seen=0, name="fast"))
    arm.receive(page, SetLive(kind="set_live", seq=2, seen=0, on=True))
    return page


@pytest.mark.full
def test_stop_of_one_arm_leaves_other_in_live_mode(two_arms):
    arms, listed = two_arms
    for arm in arms.all():
        live(arm)
    client = listed.connect(Permission.CONTROL)
    tell(listed, client, "stop_arms", name="koch")
    until(lambda: said(listed, client)["koch"]["state"] == "stopped")
    assert said(listed, client)["koch"]["text"].startswith("Stopped from the list of arms")
    assert said(listed, client)["so101"]["state"] == "live"
    tell(listed, client, "stop_arms")
    until(lambda: said(listed, client)["so101"]["state"] == "stopped")
    assert said(listed, client)["so101"]["text"].startswith("Stopped by Stop all on the page")


@pytest.mark.full
@pytest.mark.parametrize("key", ["Space", "Escape"])
def test_stop_reason_of_arms_stopped_by_key_names_the_key(two_arms, key):
    arms, listed = two_arms
    client = listed.connect(Permission.CONTROL)
    for arm in arms.all():
        live(arm)
    tell(listed, client, "stop_arms", by=key)
    until(lambda: {row["state"] for row in said(listed, client).values()} == {"stopped"})
    for row in said(listed, client).values():
        assert row["text"].startswith(f"Stopped by the {key} key on the page")


@pytest.mark.full
def test_pulled_cable_stops_only_its_arm(two_arms):
    arms, listed = two_arms
    for arm in arms.all():
        live(arm)
    client = listed.connect(Permission.WATCH)
    line_of(arms.find("so101").arm_thread.arm).plugged = False
    until(lambda: said(listed, client)["so101"]["state"] == "stopped")
    assert "Lost connection" in said(listed, client)["so101"]["text"]
    assert said(listed, client)["koch"]["state"] == "live"
    assert arms.find("koch").arm_thread.arm.where().joints


@pytest.mark.full
def test_arm_is_opened_and_closed_from_list_with_torque_off(two_arms):
    arms, listed = two_arms
    client = listed.connect(Permission.CONTROL)
    listed._choices.start()
    listed._choices.wait()
    tell(listed, client, "open_arm", arm="planar3", port="sim")
    until(lambda: said(listed, client)["planar3"]["state"] == "preview")
    planar = arms.find("planar3")
    assert set(registers(planar.arm_thread.arm, "torque_enable").values()) == {0}
    until(lambda: "limp" in said(listed, client)["planar3"]["text"])
    page = planar.connect(Permission.CONTROL)
    assert planar.frames(page)[0]["arm"] == "planar3"
    tell(listed, client, "close_arm", name="planar3")
    with pytest.raises(SessionEndedError):
        planar.frames(page)
    planar.disconnect(page)
    until(lambda: "planar3" not in said(listed, client))
    assert arms.find("planar3") is None
    assert arms.find("").name == "so101"


@pytest.mark.full
def test_second_arm_of_same_model_gets_its_own_name(two_arms):
    arms, _ = two_arms
    arms.start_opening(ArmAtPort(load_model("koch"), "sim"))
    until(lambda: arms.find("koch-2"))
    assert [arm.name for arm in arms.all()] == ["so101", "koch", "koch-2"]


@pytest.mark.full
def test_arm_that_cannot_be_opened_is_listed_with_reason():
    with served(("koch", NOT_THERE), ("so101", "sim")) as (arms, listed):
        client = listed.connect(Permission.CONTROL)
        row = said(listed, client)["koch"]
        assert row["state"] == "failed"
        assert NOT_THERE in row["text"] + row["hint"]
        assert arms.find("").name == "so101"
        assert arms.find("koch") is None
        tell(listed, client, "close_arm", name="koch")
        until(lambda: "koch" not in said(listed, client))


@pytest.mark.full
def test_arm_at_unknown_or_used_port_is_refused(two_arms, monkeypatch):
    arms, listed = two_arms
    client = listed.connect(Permission.CONTROL)
    listed._choices.start()
    listed._choices.wait()
    for arm, port in [("so101", "/etc/passwd"), ("../so101", "sim"), ("so101", "tcp:host:1")]:
        with pytest.raises(BadMessageError):
            tell(listed, client, "open_arm", arm=arm, port=port)
    koch = ArmAtPort(load_model("koch"), NOT_THERE)
    monkeypatch.setattr(arms.find("koch"), "place", koch)
    with pytest.raises(BadMessageError, match=f"koch is open on {NOT_THERE}"):
        arms.start_opening(koch)
    assert [arm.name for arm in arms.all()] == ["so101", "koch"]


def test_watcher_can_stop_arms_but_not_open_or_close_them(two_arms):
    arms, listed = two_arms
    client = listed.connect(Permission.WATCH)
    assert set(said(listed, client)) == {"so101", "koch"}
    for kind, fields in [("find_choices", {}), ("open_arm", {"arm": "koch", "port": "sim"}),
                         ("close_arm", {"name": "koch"})]:  # fmt: skip
        with pytest.raises(BadMessageError, match="can only watch"):
            tell(listed, client, kind, **fields)
    assert [arm.is_open for arm in arms.all()] == [True, True]
    assert not any(arm.arm_thread.arm.stop_reason for arm in arms.all())
    tell(listed, client, "stop_arms")
    assert all(arm.arm_thread.arm.stop_reason for arm in arms.all())


def test_calibrated_arms_are_listed_with_their_current_port(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    adapter = SerialAdapter("/dev/ttyACM3", "", 0x1A86, 0x55D3, "58FA0834561")
    monkeypatch.setattr(arm_choices, "list_adapters", lambda: [adapter])
    monkeypatch.setattr(SerialAdapter, "used_by", property(lambda _: "lerobot (process 7)"))
    for arm, serial in [("so101", "58FA0834561"), ("koch", "ELSEWHERE")]:
        path = calibration_path(arm, serial)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    found = find_choices([ArmAtPort(load_model("px100"), "/dev/pts/9")])
    assert {"arm": "so101", "adapter": "58FA0834561", "port": "/dev/ttyACM3",
            "state": "calibrated"} in found.own  # fmt: skip
    assert {"arm": "koch", "adapter": "ELSEWHERE", "port": "", "state": "calibrated"} in found.own
    assert list(found.ports) == ["/dev/ttyACM3", "/dev/pts/9", "sim"]
    assert "used by lerobot (process 7)" in found.ports["/dev/ttyACM3"]

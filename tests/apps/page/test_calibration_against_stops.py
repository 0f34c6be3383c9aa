"""A calibration against the stops, begun and answered on the page, in virtual time."""

import pytest

from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.calibration_panel import CalibrationDriver, calibration_fields
from ikservo.arm import StopKind, StopReason
from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.maintenance.direction_check import directions_confirmed
from ikservo.model import load_model
from servosim.faults import Fault
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration

STOP = StopReason(StopKind.CLIENT, "Stopped from the page.")


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def arm(monkeypatch, narrow):
    return connect_arm(monkeypatch, narrow, sign=1)


@pytest.fixture
def driver(arm, narrow):
    return CalibrationDriver(load_model(narrow), PORT, "home")


def run(driver, answers=None, on_view=lambda _: None):
    """Answer each screen with its first choice, or as in ``answers``; return the screens."""
    screens, driver.log = [], []
    driver.log_message = driver.log.append
    driver.request_start()
    for view in driver.run():
        shown = calibration_fields(view)
        if not screens or shown != screens[-1]:
            screens.append(shown)
        on_view(shown)
        words = {"How do you want": "stops", **(answers or {})}
        word = next((words[part] for part in words if part in shown["task"]), None)
        if word is None and shown["choices"] and not shown["moves"]:
            word = shown["choices"][0]["answer"]
        if word and "Hold it still" not in shown["task"]:
            driver.put_answer(word, view.number)
    return screens


def holding(arm):
    return [servo.drive.torque_on for servo in arm.line.servos.values()]


def saved():
    path = calibration_path("narrow", SERIAL)
    return read_calibration(path) if path.exists() else None


def choices(shown):
    return [choice["answer"] for choice in shown["choices"]]


def test_page_offers_each_way_to_calibrate_in_one_sentence(driver):
    first = run(driver, {"How do you want": "cancel"})[0]
    assert choices(first) == ["accept", "stops", "cancel"]
    heads = [line.partition(":")[0] for line in first["lines"]]
    assert heads == ["By hand", "Against the stops", "Not with a camera"]


def test_page_gives_reason_if_arm_must_not_search_for_stops(monkeypatch):
    connect_arm(monkeypatch, "vx300s")
    driver = CalibrationDriver(load_model("vx300s"), PORT, "rest")
    first = run(driver, {"How do you want": "cancel"})[0]
    assert choices(first) == ["accept", "cancel"]
    assert "strong enough to hurt somebody" in first["lines"][1]


@pytest.mark.full
def test_calibration_against_stops_is_saved_from_page(driver, arm, narrow):
    screens = run(driver)
    warning = next(each for each in screens if each["task"] == "Begin?")["lines"][0]
    assert "Clear its whole reach. The Stop button stops the arm" in warning
    shares = [each["share"] for each in screens if each["share"] is not None]
    assert shares == sorted(shares)
    assert {each["stage"] for each in screens} == {"anchor", "sweep", "review", "saved"}
    assert all(choices(each) == ["cancel"] for each in screens if each["moves"])
    assert [joint.swept for joint in saved().joints] == ["by itself", "by itself"]
    assert directions_confirmed(load_model(narrow), PORT)
    assert not any(holding(arm))


@pytest.mark.parametrize("part", ["How do you want", "Begin?", "Put the arm"])
def test_leaving_before_search_changes_nothing(driver, arm, part):
    before = registers(arm)
    assert run(driver, {part: "cancel"})[-1]["stage"] == "anchor"
    assert (registers(arm), any(holding(arm)), saved()) == (before, False, None)


def test_leaving_does_not_relax_an_arm_that_was_not_moved(driver, arm):
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 1)
    shown = run(driver, {"Begin?": "cancel"})[-1]
    assert "Begin?" in shown["task"]
    assert all(holding(arm))


def registers(arm):
    return [servo.read("homing_offset") for servo in arm.line.servos.values()]


def limp_after(driver, screens, arm):
    """Return the last screen, which must say that the arm holds, and offer only to release it."""
    assert choices(screens[-1]) == ["accept"]
    assert "The arm holds now. Support it" in screens[-1]["task"]
    assert not any(holding(arm))
    assert (driver.requested, driver.arm, saved()) == (False, None, None)
    return screens[-1]["task"]


@pytest.mark.full
def test_search_stopped_from_page_holds_until_released(driver, arm):
    held = []

    def stop(shown):
        if shown["share"]:
            driver.request_stop(STOP)
        held.extend([all(holding(arm))] if shown["stage"] == "held" else [])

    assert STOP.text in limp_after(driver, run(driver, on_view=stop), arm)
    assert held[0]


@pytest.mark.full
@pytest.mark.parametrize("silent_s", [1.0, 4.0])
def test_arm_is_released_although_a_servo_was_silent(driver, arm, silent_s):
    """A servo falls silent in the search, and again where the person switches torque off."""
    faults, world = arm.line.faults, arm.line.world
    servo = next(iter(arm.line.servos))

    def silence(shown):
        began = shown["share"] and not faults.added
        if began or (shown["stage"] == "held" and len(faults.added) == 1):
            faults.added.append(world.time_s)
            faults.add(Fault("silent", id=servo, at_s=world.time_s, for_s=silent_s))

    faults.added = []
    limp_after(driver, run(driver, on_view=silence), arm)
    assert len(faults.added) == 2


@pytest.mark.full
def test_leaving_moving_arm_brakes_it_first(driver, arm):
    def leave(shown):
        if shown["share"]:
            driver.put_answer("cancel", 0)

    assert "The calibration was cancelled." in limp_after(driver, run(driver, on_view=leave), arm)


@pytest.mark.parametrize(
    ("word", "reason"), [("no", "does not move as the arm file says"), ("cancel", "was cancelled")]
)
def test_wrong_direction_on_page_ends_search(driver, arm, word, reason):
    assert reason in limp_after(driver, run(driver, {"Did joint1": word}), arm)


@pytest.mark.full
def test_page_keeps_measured_joints_for_next_search(driver, arm):
    motor = arm.joint("joint1").servos[0].motor
    motor.lower_stop_rad = -0.1
    assert "joint1 hit something at" in limp_after(driver, run(driver), arm)
    assert any("kept for the next run: joint2" in line for line in driver.log)
    offer = run(driver, {"Use these results": "cancel"})[-1]
    assert choices(offer) == ["accept", "no", "cancel"]
    assert "measured joint2." in offer["lines"][1]


@pytest.fixture
def thread(arm, narrow, driver):
    """Return an arm thread whose page is in control, before the calibration runs."""
    write_calibration(arm)
    clock = arm.port.clock
    thread = ArmThread(lambda: open_own_arm(load_model(narrow), PORT), clock, 0.3, driver)
    thread.page = thread.lease.acquire("a page", take_over=True).lease
    return thread


def search(thread, on_share):
    """Run the calibration in the thread; ``on_share`` acts at each view of a search."""
    driver, run_driver, shown = thread.calibration, thread.calibration.run, []

    def answered():
        for view in run_driver():
            yield view
            shown.append(fields := calibration_fields(view))
            thread.lease.refresh(thread.page)
            if fields["moves"]:
                on_share(fields)
            elif "Hold it still" not in fields["task"]:
                word = "stops" if "stops" in choices(fields) else "accept"
                driver.put_answer(word, view.number)

    driver.run = answered
    driver.request_start()
    thread.step()
    return shown


def stop(thread):
    return lambda shown: shown["share"] and thread.request_stop(STOP)


@pytest.mark.full
def test_stop_of_page_reaches_arm_that_searches(thread, arm):
    thread.lease.silence_s = lambda: 0.0
    before, shown = registers(arm), search(thread, stop(thread))
    assert STOP.text in shown[-1]["task"]
    thread.step()
    assert thread.snapshot.stop_notice is None  # the limp arm needs no acknowledgement
    assert (thread.snapshot.calibration, registers(arm)) == (None, before)
    thread.arm.close("hold")


def test_silent_page_stops_arm_that_searches(thread, arm):
    shown = search(thread, lambda _: None)  # no heartbeat comes during a motion
    assert "the page does not answer" in shown[-1]["task"]
    assert not any(holding(arm))
    thread.arm.close("hold")


def test_stop_of_page_leaves_calibration_by_hand_alone(thread):
    driver, run_driver, counts = thread.calibration, thread.calibration.run, []

    def watched():
        for number, view in enumerate(run_driver()):
            if number == 0:
                driver.put_answer("accept", view.number)  # by hand
            if number == 2:
                thread.request_stop(STOP)
            if number == 6:
                driver.put_answer("cancel", view.number)
            counts.append(thread.snapshot.stop_count)
            yield view

    driver.run = watched
    driver.request_start()
    thread.step()
    assert counts == [0, 0, 0, 1, 1, 1, 1]  # one stop is confirmed once
    assert (driver.requested, thread.snapshot.calibration) == (False, None)
    thread.arm.close("hold")


def test_closed_page_leaves_arm_holding_in_its_search(thread, arm):
    def close(shown):
        thread._ending = True
        thread.request_stop(STOP)

    thread.lease.silence_s = lambda: 0.0
    search(thread, close)
    assert all(holding(arm))
    assert "ikservo calibration revert" in thread.snapshot.stop_notice.hint

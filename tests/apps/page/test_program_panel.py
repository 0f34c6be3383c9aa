"""The page's program in virtual time: taught, edited, saved, checked, played, stopped, resumed."""

import math
import time

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages import program_messages as msg
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.running.record_job import SUFFIX
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.teaching.program import Program, ProgramStep, read_program, write_program
from ikservo.apps.teaching.recorder import recording_header
from ikservo.apps.teaching.recording import RecordingWriter
from ikservo.planning.motions import MoveJoints, Wait
from servosim.faults import Fault
from servosim.joint import Hand, glide
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, registers, true_joints, true_tip_m


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    return tmp_path / "programs"


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


def panel(session):
    return session.controller._program


def add(session, what, **fields):
    session.send_message(msg.AddStep, what=what, **fields)
    return panel(session).draft.steps[-1].number


def teach_target(session, joint, value, path="joints"):
    """Add a step that turns one joint, as the target of the preview."""
    session.send_message(page_messages.SetJoint, joint=joint, value=value)
    return add(session, "target", path=path)


def run(session, action="play", step=None, on_cycle=lambda _count: None):
    """Let the arm thread carry out a command, with heartbeats; return its state afterwards."""
    session.send_message(msg.RunProgram, action=action, step=step)
    arm_thread, count = session.arm_thread, 0
    before = {name: getattr(arm_thread, name) for name in ("on_progress", "on_idle")}

    def reported(name):
        def tell(*progress):
            nonlocal count
            count += 1
            session.send_message(page_messages.Heartbeat, visible=True)
            before[name](*progress)
            on_cycle(count)

        return tell

    for name in before:
        setattr(arm_thread, name, reported(name))
    session.send_message(page_messages.Heartbeat, visible=True)
    arm_thread.step()
    for name in before:
        delattr(arm_thread, name)
    return panel(session).state_fields()


def degrees(session, joint):
    return math.degrees(true_joints(session.arm)[joint])


@pytest.mark.full
def test_program_steps_run_in_order_and_move_gripper(session):
    teach_target(session, "wrist_roll", 20.0)
    add(session, "open")
    add(session, "wait", wait_s=0.3)
    last = teach_target(session, "wrist_roll", -10.0)
    session.send_message(msg.MoveStep, step=last, to=0)
    gripper = true_joints(session.arm)["gripper"]
    state = run(session)
    assert (state["phase"], state["reason"]) == ("done", "")
    assert degrees(session, "wrist_roll") == pytest.approx(20.0, abs=0.5)
    assert true_joints(session.arm)["gripper"] > gripper + 0.3


def test_current_pose_is_added_as_joint_step_or_line_step(session):
    add(session, "arm")
    add(session, "arm", path="line")
    by_joints, by_line = (each.step for each in panel(session).draft.steps)
    at = true_joints(session.arm)
    assert set(by_joints.deg) == set(session.arm.chain.names)
    for joint, value in by_joints.deg.items():
        assert value == pytest.approx(math.degrees(at[joint]), abs=0.2)
    assert by_line.tip_m == pytest.approx(true_tip_m(session.arm), abs=0.002)
    assert by_line.path == "line"
    shown = [each["text"] for each in panel(session).fields()["steps"]]
    assert all(
        text.startswith(words) for text, words in zip(shown, ["to ", "line to "], strict=True)
    )


def test_error_names_impossible_step_before_arm_moves(session):
    teach_target(session, "wrist_roll", 20.0)
    session.send_message(page_messages.SetJoint, joint="shoulder_lift", value=90.0)
    session.send_message(page_messages.SetJoint, joint="elbow_flex", value=-20.0)
    bad = add(session, "target")
    add(session, "wait")
    before = registers(session.arm, "goal_position")
    for action in ("check", "play"):
        state = run(session, action)
        assert (state["phase"], state["step"]) == ("bad", bad)
        (problem,) = state["problems"]
        assert problem["step"] == bad
        assert "gripper would touch the table" in problem["reason"]
    assert registers(session.arm, "goal_position") == before
    assert session.arm_thread.snapshot.stop_notice is None
    assert "Step 2 of the program" in session.arm_thread.snapshot.messages[-1].message
    session.send_message(msg.DeleteStep, step=bad)
    assert panel(session).state_fields()["phase"] == "idle"
    assert run(session, "check")["phase"] == "ok"
    assert registers(session.arm, "goal_position") == before


@pytest.mark.full
def test_stopped_program_resumes_in_its_step_after_acknowledge(session):
    teach_target(session, "wrist_roll", 5.0)
    second = teach_target(session, "wrist_roll", 60.0)

    def stop_in_second(_count):
        if panel(session).state_fields()["step"] == second and degrees(session, "wrist_roll") > 15:
            session.send_message(page_messages.Stop)

    state = run(session, on_cycle=stop_in_second)
    assert (state["phase"], state["step"]) == ("stopped", second)
    held = degrees(session, "wrist_roll")
    assert held < 40.0
    with pytest.raises(BadMessageError, match="was stopped"):
        session.send_message(msg.RunProgram, action="play")
    session.arm_thread.step()
    assert degrees(session, "wrist_roll") == pytest.approx(held, abs=2.0)
    session.send_message(page_messages.Acknowledge)
    for _ in range(3):
        session.arm_thread.step()
    assert degrees(session, "wrist_roll") == pytest.approx(held, abs=2.0)
    assert run(session, step=second)["phase"] == "done"
    assert degrees(session, "wrist_roll") == pytest.approx(60.0, abs=0.5)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("kind", "words"),
    [("silent", "does not answer"), ("reset", "does not answer")],
)
def test_servo_fault_stops_program_in_its_step(session, kind, words):
    add(session, "wait", wait_s=0.2)
    turning = teach_target(session, "wrist_roll", 60.0)
    line, failed = line_of(session.arm), []

    def fail(_count):
        if degrees(session, "wrist_roll") > 15 and not failed:
            failed.append(kind)
            line.faults.add(Fault(kind, id=5, at_s=line.world.time_s))

    state = run(session, on_cycle=fail)
    assert (state["phase"], state["step"]) == ("stopped", turning)
    assert words in state["reason"]
    assert session.arm_thread.snapshot.stop_notice is not None


def test_program_check_on_page_lists_all_impossible_steps(session):
    teach_target(session, "wrist_roll", 20.0)
    folder = panel(session).draft.folder.path
    folder.mkdir(parents=True, exist_ok=True)
    bad = []
    for name in ("one", "two"):
        (folder / f"{name}{SUFFIX}").write_text("not a recording")
        bad.append(add(session, "recording", recording=name))
        add(session, "wait")
    session.send_message(msg.SetProgram, speed="normal", repeat=2)
    state = run(session, "check")
    assert (state["phase"], state["step"]) == ("bad", bad[0])
    assert [each["step"] for each in state["problems"]] == bad
    said = [each.message for each in session.arm_thread.snapshot.messages[-2:]]
    assert [message.partition(" of")[0] for message in said] == ["Step 2", "Step 4"]


@pytest.mark.campaign
def test_program_pauses_after_step_and_runs_single_steps(session):
    first = teach_target(session, "wrist_roll", 10.0)
    second = teach_target(session, "wrist_roll", 20.0)
    third = teach_target(session, "wrist_roll", 30.0)
    state = run(session, "step")
    assert (state["phase"], state["step"]) == ("paused", second)
    assert degrees(session, "wrist_roll") == pytest.approx(10.0, abs=0.5)

    def pause(count):
        if count == 40:
            session.send_message(msg.RunProgram, action="pause")

    state = run(session, "play", second, on_cycle=pause)
    assert (state["phase"], state["step"], state["pausing"]) == ("paused", third, False)
    assert run(session, "step", third)["phase"] == "done"
    assert degrees(session, "wrist_roll") == pytest.approx(30.0, abs=0.5)
    assert panel(session).state_fields()["step"] == first


def test_program_waits_in_a_pause_until_continue(session, own_folder):
    own_folder.mkdir(parents=True, exist_ok=True)
    steps = ({"wait_s": 0.01}, {"pause": "Put in the next part."}, {"wait_s": 0.01})
    made = tuple(ProgramStep(**step) for step in steps)
    write_program(own_folder / "parts.toml", Program(format=1, arm="so101", steps=made))
    session.send_message(msg.ProgramFile, action="load", name="parts")
    session.send_message(msg.SetProgram, speed="slow", repeat="until stopped")
    seen = []

    def answer(count):
        state = panel(session).state_fields()
        if state["phase"] == "waiting":
            seen.append((state["reason"], state["repetition"]))
            action = "play" if len(seen) < 20 else "pause"
            session.send_message(msg.RunProgram, action=action)

    state = run(session, on_cycle=answer)
    assert state["phase"] == "paused"
    assert seen[0] == ("Put in the next part.", 1)
    assert seen[-1][1] > 5  # it is repeated


def save_program(folder, *steps, **options):
    folder.mkdir(parents=True, exist_ok=True)
    made = tuple(ProgramStep(**step) for step in steps)
    write_program(folder / "parts.toml", Program(format=1, arm="so101", steps=made, **options))


def test_program_whose_called_program_is_missing_can_be_edited(session, own_folder):
    save_program(own_folder, {"wait_s": 0.01}, {"program": "gone.toml"})
    session.send_message(msg.ProgramFile, action="load", name="parts")
    state = run(session, "check")
    assert state["phase"] == "bad"
    assert "gone.toml" in state["problems"][0]["reason"]
    assert session.arm_thread.snapshot.stop_notice is None
    session.send_message(msg.ProgramFile, action="new")


def test_single_step_command_runs_whole_called_program(session, own_folder):
    save_program(own_folder, {"wait_s": 0.01}, {"wait_s": 0.01})
    (own_folder / "parts.toml").rename(own_folder / "inner.toml")
    save_program(own_folder, {"program": "inner.toml"}, {"wait_s": 0.01, "only_if": "grasped"},
                 {"wait_s": 0.01})  # fmt: skip
    session.send_message(msg.ProgramFile, action="load", name="parts")
    first, second, third = (each.number for each in panel(session).draft.steps)
    state = run(session, "step", first)
    assert (state["phase"], state["step"]) == ("paused", third)  # the second does not apply
    state = run(session, "step", second)
    assert (state["phase"], state["step"]) == ("paused", third)  # and nothing else was run


def test_resumed_program_continues_in_same_repetition(session, own_folder):
    save_program(own_folder, {"wait_s": 0.01}, {"pause": "Look."}, repeat=5)
    session.send_message(msg.ProgramFile, action="load", name="parts")
    seen, number = [], panel(session).draft.steps[1].number

    def answer(count):
        state = panel(session).state_fields()
        if state["phase"] == "waiting" and (not seen or seen[-1] != state["repetition"]):
            seen.append(state["repetition"])
            session.send_message(msg.RunProgram, action="pause" if len(seen) == 2 else "play")

    state = run(session, on_cycle=answer)
    assert (state["phase"], state["repetition"]) == ("paused", 3)
    assert run(session, step=state["step"], on_cycle=answer)["phase"] == "done"
    assert seen == [1, 2, 3, 4, 5]
    assert number == panel(session).draft.steps[1].number


def test_closed_page_stops_program(session):
    teach_target(session, "wrist_roll", 60.0)

    def leave(count):
        if count == 60:
            session.controller.disconnect(session.client)
            session.client = session.connect()

    state = run(session, on_cycle=leave)
    assert state["phase"] == "stopped"
    assert degrees(session, "wrist_roll") < 40.0
    assert "closed" in session.arm_thread.snapshot.stop_notice.message


@pytest.mark.full
def test_running_program_blocks_other_motions_and_edits(session):
    teach_target(session, "wrist_roll", 40.0)
    refused = []

    def try_all(count):
        if count != 60:
            return
        for kind, fields in [
            (page_messages.SetJoint, {"joint": "wrist_roll", "value": -40.0}),
            (page_messages.SetTorque, {"joint": "wrist_roll", "on": False}),
            (page_messages.SetLive, {"on": True}),
            (page_messages.CalibrationAnswer, {"action": "start"}),
            (msg.AddStep, {"what": "wait"}),
            (msg.RunProgram, {"action": "play"}),
        ]:
            with pytest.raises(BadMessageError) as error:
                session.send_message(kind, **fields)
            refused.append(error.value.message)

    assert run(session, on_cycle=try_all)["phase"] == "done"
    assert len(refused) == 6
    assert degrees(session, "wrist_roll") == pytest.approx(40.0, abs=0.5)


def test_saved_program_is_read_by_command_and_loaded_unchanged(session, own_folder):
    turn = teach_target(session, "wrist_roll", 20.0)
    add(session, "pose", pose="home")
    session.send_message(msg.ChangeStep, step=turn, speed="fast")
    session.send_message(msg.SetProgram, speed="normal", repeat=3)
    session.send_message(msg.ProgramFile, action="save", name="tea")
    saved = read_program(own_folder / "tea.toml")
    assert (saved.arm, saved.speed, saved.repeat) == ("so101", "normal", 3)
    assert [step.action for step in saved.steps] == ["joints", "pose"]
    assert saved.steps[0].speed == "fast"
    session.send_message(msg.ProgramFile, action="new")
    assert panel(session).draft.steps == ()
    session.send_message(msg.ProgramFile, action="load", name="tea")
    assert panel(session).draft.program() == saved
    assert panel(session).fields()["names"] == ["tea"]


def test_invalid_program_files_and_steps_are_refused_on_page(session, own_folder):
    kept = add(session, "wait")
    own_folder.mkdir()
    (own_folder / "broken.toml").write_text('format = 1\narm = "so101"\n[[steps]]\nwait_s = -1.0\n')
    (own_folder / "other.toml").write_text('format = 1\narm = "koch"\n[[steps]]\nwait_s = 1.0\n')
    for kind, fields, words in [
        (msg.ProgramFile, {"action": "load", "name": "broken"}, r"step 1, wait_s"),
        (msg.ProgramFile, {"action": "load", "name": "other"}, "for koch"),
        (msg.ProgramFile, {"action": "load", "name": "none"}, "no program"),
        (
            msg.ProgramFile,
            {"action": "save", "name": "other"},
            "A program named other already exists",
        ),
        (msg.AddStep, {"what": "target"}, "No target is shown"),
        (msg.AddStep, {"what": "pose", "pose": "hoem"}, "home"),
        (msg.AddStep, {"what": "wait", "after": 99}, "That step no longer exists"),
        (msg.DeleteStep, {"step": 99}, "That step no longer exists"),
        (msg.ChangeStep, {"step": 99}, "That step no longer exists"),
        (msg.ChangeStep, {"step": kept, "pause": "look"}, "This step has another action"),
        (msg.AddStep, {"what": "program", "program": "nothing"}, "nothing"),
        (msg.RunProgram, {"action": "play", "step": 99}, "That step no longer exists"),
        (msg.RunProgram, {"action": "pause"}, "No program is being played"),
    ]:
        with pytest.raises(BadMessageError, match=words):
            session.send_message(kind, **fields)
    assert [each.number for each in panel(session).draft.steps] == [kept]
    assert (own_folder / "other.toml").read_text().startswith('format = 1\narm = "koch"')
    session.send_message(msg.DeleteStep, step=kept)
    with pytest.raises(BadMessageError, match="has no steps"):
        session.send_message(msg.RunProgram, action="play")


def test_condition_pause_and_called_program_are_saved_and_played(session, own_folder):
    teach_target(session, "wrist_roll", 20.0)
    session.send_message(msg.ProgramFile, action="save", name="turn")
    session.send_message(msg.ProgramFile, action="new")
    never = teach_target(session, "wrist_roll", -30.0)
    session.send_message(msg.ChangeStep, step=never, only_if="grasped")
    pause = add(session, "pause")
    session.send_message(
        msg.ChangeStep, step=pause, pause="Put a cup there.", only_if="not grasped"
    )
    add(session, "program", program="turn")
    session.send_message(msg.ProgramFile, action="save", name="all")
    steps = read_program(own_folder / "all.toml").steps
    assert [step.only_if for step in steps] == ["grasped", "not grasped", None]
    assert (steps[1].pause, steps[2].program) == ("Put a cup there.", "turn.toml")
    seen = []

    def answer(_count):
        state = panel(session).state_fields()
        if state["phase"] == "waiting":
            seen.append(state["reason"])
            session.send_message(msg.RunProgram, action="play")

    assert run(session, on_cycle=answer)["phase"] == "done"
    assert set(seen) == {"Put a cup there."}
    assert degrees(session, "wrist_roll") == pytest.approx(20.0, abs=0.5)


def change_grid(session, number, corner=None, **fields):
    session.send_message(msg.ChangeStep, step=number, grid=fields, corner=corner)


def move_joint(session, joint, value):
    session.arm.move_joints({joint: math.radians(value)})
    session.arm_thread.step()


def test_grid_is_taken_from_tip_edited_and_saved(session, own_folder):
    number = add(session, "grid")
    first_m = np.array(panel(session).draft.steps[0].step.tip_m)
    assert first_m == pytest.approx(true_tip_m(session.arm), abs=2e-3)
    assert panel(session).fields()["steps"][0]["text"].endswith("6 places")
    change_grid(session, number, rows=4, columns=5)
    change_grid(session, number, column_m=[0.03, 0.0, 0.005])
    move_joint(session, "shoulder_pan", 12.0)
    change_grid(session, number, corner="row_m")
    session.send_message(msg.ProgramFile, action="save", name="tray")
    grid = read_program(own_folder / "tray.toml").steps[0].grid
    assert (grid.rows, grid.columns, grid.column_m) == (4, 5, (0.03, 0.0, 0.005))
    last_m = np.array(grid.place_m(first_m, 16))  # first place of the last row
    assert last_m == pytest.approx(true_tip_m(session.arm), abs=2e-3)
    change_grid(session, number, corner="tip_m")
    assert panel(session).draft.steps[0].step.tip_m == pytest.approx(tuple(last_m), abs=1e-4)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"rows": 0}, r"step 2, grid.rows: is 0; expected rows and columns from 1 to 30"),
        ({"rows": 1000, "columns": 1000}, r"step 2, grid.rows: is 1000; expected rows"),
        ({"columns": "many"}, r'step 2, grid.columns: is "many"'),
        ({"row_m": [0.0, "far", 0.0]}, r'step 2, grid.row_m\[1\]: is "far"'),
        ({"row_m": [0.0, 0.0]}, r"step 2, grid.row_m\[2\]: is missing"),
    ],
)
def test_bad_grid_gets_sentence_of_program_and_changes_nothing(session, fields, words):
    add(session, "wait")
    number = add(session, "grid")
    before = panel(session).draft.steps
    with pytest.raises(BadMessageError, match=words):
        change_grid(session, number, **fields)
    assert panel(session).draft.steps == before


def test_grid_places_are_visited_in_turn_by_repetitions(session):
    number = add(session, "grid", path="line")
    change_grid(session, number, rows=1, columns=2, column_m=[-0.02, 0.0, 0.0])
    first_m = np.array(panel(session).draft.steps[0].step.tip_m)
    session.send_message(msg.SetProgram, speed="fast", repeat=2)
    assert run(session)["phase"] == "done"
    assert true_tip_m(session.arm) == pytest.approx(first_m - [0.02, 0.0, 0.0], abs=2e-3)


def watch_time(session, action="play"):
    """Play the program; return the time and the texts that the page shows in each cycle."""
    watcher = session.connect(Permission.WATCH)
    seen, frames = [], session.latest_frames(watcher)

    def look(_count):
        frames.update({frame["kind"]: frame for frame in session.controller.frames(watcher)})
        status, left = frames["status"], frames["program_state"]["left"]
        seen.append((session.clock.now_s(), status["activity"], status["left"], left))

    assert run(session, action, on_cycle=look)["phase"] in ("done", "paused")
    assert session.latest_frames(watcher)["status"]["left"] == ""
    assert panel(session).state_fields()["left"] == ""
    return seen


def seconds(text):
    return float(text.removeprefix("about ").removesuffix(" s left"))


def test_time_left_of_program_counts_down_to_its_end(session):
    for value in (60.0, -60.0):
        teach_target(session, "wrist_roll", value)
    add(session, "wait", wait_s=3.0)
    seen = watch_time(session)
    shown = [(at_s, seconds(left)) for at_s, _, _, left in seen if left]
    end_s = seen[-1][0]
    assert shown[-1][1] <= 1.0
    for at_s, left_s in shown:
        assert left_s == pytest.approx(end_s - at_s, abs=1.5)


def test_time_left_of_each_motion_is_shown_with_its_step(session):
    for value in (60.0, -60.0):
        teach_target(session, "wrist_roll", value)
    seen = watch_time(session)
    for step in (1, 2):
        title = f"Playing the program, step {step} of 2"
        left = [seconds(text) for _, activity, text, _ in seen if activity == title and text]
        assert left == sorted(left, reverse=True)
        assert left[0] > 1.0
        assert left[-1] == 0.0


def test_time_left_is_empty_if_program_has_unknown_durations(session):
    session.send_message(msg.SetProgram, speed="fast", repeat=2)
    teach_target(session, "wrist_roll", 20.0)
    add(session, "close")
    teach_target(session, "wrist_roll", -20.0)
    left = [text for *_, text in watch_time(session)]
    known = [bool(text) for text in left]
    assert not known[0]  # nothing has shown how long the gripper takes
    assert known[-2]
    conditional = panel(session).draft.steps[0].number
    session.send_message(msg.ChangeStep, step=conditional, only_if="not grasped")
    assert not any(text for *_, text in watch_time(session))


def test_time_left_of_motion_is_planned_duration_less_elapsed(session):
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=80.0)
    session.planned()
    planned_s, shown = session.interaction.path.plan.duration_s, []
    go(session, lambda: shown.append(session.arm_thread.snapshot.activity.left))
    left = [seconds(text) for text in shown if text]
    assert left[0] == pytest.approx(planned_s, abs=0.6)
    assert set(left) == set(range(round(planned_s) + 1))
    assert session.latest_frames()["status"]["left"] == ""


def test_time_left_of_program_is_not_shown_for_one_step(session):
    add(session, "wait", wait_s=2.0)
    add(session, "wait", wait_s=2.0)
    assert not any(text for *_, text in watch_time(session, "step"))


def test_time_left_is_empty_if_program_repeats_until_stopped(session):
    session.send_message(msg.SetProgram, speed="fast", repeat="until stopped")
    teach_target(session, "wrist_roll", 20.0)
    seen = []

    def look(count):
        seen.append(panel(session).state_fields()["left"])
        if count == 60:
            session.send_message(msg.RunProgram, action="pause")

    assert run(session, on_cycle=look)["phase"] == "paused"
    assert not any(seen)


def test_a_watcher_sees_the_program_and_cannot_change_it(session):
    watcher = session.connect(Permission.WATCH)
    with pytest.raises(BadMessageError, match="can only watch"):
        session.send_message(msg.AddStep, watcher, what="wait")
    number = add(session, "wait")
    shown = session.latest_frames(watcher)
    assert [step["number"] for step in shown["program"]["steps"]] == [number]
    assert shown["program_state"]["phase"] == "idle"
    assert "program" not in session.latest_frames(watcher)


def record(session, on_cycle, cycles=60):
    """Record the arm for a number of samples; ``on_cycle`` moves it meanwhile."""
    session.send_message(msg.RecordStep, on=True)
    idle, count = session.arm_thread.on_idle, 0

    def reported():
        nonlocal count
        count += 1
        session.send_message(page_messages.Heartbeat, visible=True)
        idle()
        on_cycle(count)
        if count == cycles // 5:
            session.send_message(msg.RecordStep, on=False)

    session.arm_thread.on_idle = reported
    session.send_message(page_messages.Heartbeat, visible=True)
    session.arm_thread.step()
    session.arm_thread.on_idle = idle
    return session.latest_frames()


def record_by_hand(session):
    """Record an arm whose wrist is turned by hand."""
    session.arm.disable_torque()
    world = line_of(session.arm).world
    world.grasp("wrist_roll", Hand(glide(0.0, 0.4, speed=0.8), limit=20.0))
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"):  # the other hand
        at = world.joint(joint).position
        world.grasp(joint, Hand(lambda _, at=at: (at, 0.0), limit=20.0))
    record(session, lambda _count: None)
    world.hands.clear()


@pytest.mark.full
def test_hand_guided_recording_is_replayed_as_program_step(session):
    record_by_hand(session)
    (step,) = panel(session).draft.steps
    assert step.step.recording == "recording-1.jsonl"
    there = degrees(session, "wrist_roll")
    add(session, "wait", wait_s=0.1)
    first = teach_target(session, "wrist_roll", 0.0)
    session.send_message(msg.MoveStep, step=first, to=0)
    state = run(session)
    assert state["phase"] == "done", state
    assert abs(there) > 10.0
    assert degrees(session, "wrist_roll") == pytest.approx(there, abs=1.5)


@pytest.mark.full
def test_recording_made_after_a_check_is_played(session):
    add(session, "wait", wait_s=0.1)
    assert run(session, "check")["phase"] == "ok"
    record_by_hand(session)
    assert len(panel(session).draft.steps) == 2
    state = run(session)
    assert (state["phase"], state["left"]) == ("done", "")


def recorded(session, folder, elbow_rad=0.2):
    """Write a recording of the pan that turns by 20° and back, with the elbow moved by an angle."""
    folder.mkdir(exist_ok=True)
    arm = session.arm
    start = arm.context.servos.measure_positions()
    column = arm.joint_index.column("shoulder_pan")
    joints = np.repeat(start[None], 101, axis=0)
    joints[:, column] += 0.35 * np.sin(np.linspace(0.0, np.pi, 101))
    joints[:, arm.joint_index.column("elbow_flex")] -= elbow_rad
    with RecordingWriter(folder / f"sweep{SUFFIX}", recording_header(arm.model, 0.02)) as writer:
        for count, each in enumerate(joints):
            writer.write(0.02 * count, each)
    return joints


def go(session, look=lambda: None):
    """Execute the shown path, with heartbeats; return how long that took, s."""
    on_progress, number = session.arm_thread.on_progress, session.interaction.path.number

    def answer(progress):
        session.send_message(page_messages.Heartbeat, visible=True)
        on_progress(progress)
        look()

    session.send_message(page_messages.ArmAction, action="execute", path=number)
    session.arm_thread.on_progress = answer
    begun_s = session.clock.now_s()
    session.arm_thread.step()
    session.arm_thread.on_progress = on_progress
    return session.clock.now_s() - begun_s


def show(session, step):
    """Show a step, and return the frame of its path; the page answers while it is planned."""
    session.send_message(msg.ShowStep, step=step)
    until_s = time.monotonic() + 60.0
    while time.monotonic() < until_s:
        session.send_message(page_messages.Heartbeat, visible=True)
        session.arm_thread.step()
        frames, path = session.latest_frames(), session.interaction.path
        if path is not None and (path.plan is not None or path.refusal is not None):
            return frames["scene"]
        time.sleep(0.01)
    raise AssertionError("the step is never planned")


def test_shown_step_runs_as_planned_although_its_pose_changes(session):
    arm = session.arm
    session.send_message(page_messages.SetSpeed, name="slow")
    arm.poses.save("drop", {**arm.where().positions, "shoulder_pan": 0.8})
    step = add(session, "pose", pose="drop")
    session.send_message(msg.ChangeStep, step=step, speed="fast")
    show(session, step)
    plan = session.interaction.path.plan
    arm.poses.save("drop", {**arm.where().positions, "shoulder_pan": -0.8})
    took_s = go(session)
    assert degrees(session, "shoulder_pan") == pytest.approx(math.degrees(0.8), abs=0.5)
    assert plan.speed == "slow"
    assert plan.duration_s - 0.1 < took_s < plan.duration_s + 3.0
    session.send_message(page_messages.SetSpeed, name="fast")
    for speed in ("slow", "fast"):
        session.send_message(msg.ChangeStep, step=step, speed=speed)
        show(session, step)
        assert session.interaction.path.plan.speed == speed


def test_shown_recording_runs_although_its_file_changes(session, own_folder):
    joints = recorded(session, own_folder, 0.0)
    step = add(session, "recording", recording="sweep")
    scene = show(session, step)
    assert len(scene["path"]["joints"]) == 25  # although it ends where it begins
    assert len(scene["swept"]) == 5
    (own_folder / f"sweep{SUFFIX}").write_text("damaged")
    go(session)
    assert np.abs(session.arm.context.servos.measure_positions() - joints[-1]).max() < 0.02


def test_step_with_condition_or_without_a_plan_is_not_shown(session):
    home = session.arm.where().tip_m.tolist()
    steps = (
        ProgramStep(tip_m=home, only_if="grasped"), ProgramStep(gripper="open"),
        ProgramStep(wait_s=1.0), ProgramStep(motion={"pick": {"middle_m": home}}),
    )  # fmt: skip
    for step in steps:
        number = panel(session).draft.add(step)
        session.send_message(msg.ShowStep, step=number)
        session.latest_frames()
        assert session.interaction.path is None, step


def test_chosen_step_with_recording_is_shown_and_replayed_by_go(session, own_folder):
    joints = recorded(session, own_folder)
    session.send_message(msg.ProgramFile, action="new")
    step = add(session, "recording", recording="sweep")
    before = session.ticks()
    scene = show(session, step)
    path = session.interaction.path
    index = session.arm.joint_index
    shown = np.array([chain for chain, _ in path.postures])
    furthest = max(joints, key=lambda each: abs(each[index.column("shoulder_pan")] - joints[0][0]))
    away = np.abs(shown - index.chain_joints(furthest)).max(axis=1)
    assert away.min() < 0.05
    assert np.abs(path.plan.goal - joints[-1]).max() < 0.02
    assert scene["path"]["several"]
    assert session.ticks() == before
    go(session)
    assert np.abs(session.arm.context.servos.measure_positions() - joints[-1]).max() < 0.02


def test_shown_step_is_withdrawn_by_an_edit_or_another_choice(session, own_folder):
    recorded(session, own_folder)
    session.send_message(msg.ProgramFile, action="new")
    step = add(session, "recording", recording="sweep")
    wait = add(session, "wait", wait_s=0.5)
    for withdraw in (
        lambda: session.send_message(msg.ShowStep, step=None),
        lambda: session.send_message(msg.ShowStep, step=wait),
        lambda: session.send_message(msg.ChangeStep, step=step, speed="fast"),
        lambda: session.send_message(page_messages.Stop),
    ):
        show(session, step)
        withdraw()
        session.latest_frames()
        assert session.interaction.path is None
    with pytest.raises(BadMessageError):
        session.send_message(msg.ShowStep, step=99)


def test_recording_of_arm_with_torque_on_is_refused(session):
    record(session, lambda _count: None)
    assert not panel(session).draft.steps
    assert "Press Relax or Release first" in session.arm_thread.snapshot.messages[-1].message
    assert panel(session).draft.recordings == []


@pytest.mark.full
def test_stop_ends_recording_that_remains_usable_as_step(session):
    session.arm.disable_torque()
    record(session, lambda count: count == 3 and session.send_message(page_messages.Stop))
    assert session.arm_thread.snapshot.stop_count == 1
    assert not panel(session).draft.steps
    add(session, "recording", recording="recording-1")
    assert panel(session).draft.steps[0].step.recording == "recording-1.jsonl"
    with pytest.raises(BadMessageError, match="no recording"):
        add(session, "recording", recording="elsewhere")


@pytest.mark.full
def test_program_steps_of_any_motion_are_loaded_run_and_saved(session, own_folder):
    own_folder.mkdir(parents=True, exist_ok=True)
    (own_folder / "mixed.toml").write_text(
        'format = 1\narm = "so101"\n'
        "[[steps]]\nmotion.move_joints = { positions = { wrist_roll = 0.3 } }\n"
        "[[steps]]\nmotion.wait = { duration_s = 0.1 }\n"
    )
    session.send_message(msg.ProgramFile, action="load", name="mixed")
    turn, wait = panel(session).fields()["steps"]
    assert (turn["text"], turn["has_speed"]) == ("wrist_roll 0.3", True)
    assert (wait["text"], wait["has_speed"]) == ("wait 0.1 s", False)
    session.send_message(msg.ChangeStep, step=turn["number"], speed="fast")
    assert run(session)["phase"] == "done"
    assert true_joints(session.arm)["wrist_roll"] == pytest.approx(0.3, abs=0.01)
    session.send_message(msg.ProgramFile, action="save", name="copy")
    read = read_program(own_folder / "copy.toml").steps
    assert [each.motion for each in read] == [
        MoveJoints({"wrist_roll": 0.3}),
        Wait(0.1),
    ]
    assert read[0].speed == "fast"

"""Programs of steps are read, checked step by step, run, stopped and resumed."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.program import Program, ProgramStep, read_program, write_program
from ikservo.apps.teaching.program_run import ProgramRun
from ikservo.errors import (
    BadValueError,
    FileFormatError,
    IkservoError,
    RefusedError,
    ServoAlarmError,
    StoppedError,
    UnreachableError,
)
from ikservo.planning.motions import LookAt
from servosim.faults import Fault
from tests.arm.simulated import clock_of, line_of, registers, transport_of, true_joints, true_tip_m
from tests.journeys.recordings import write_wave_recording

NEAR, FAR = (0.22, 0.04, 0.12), (0.22, -0.04, 0.12)
KINDS = (
    {"pose": "home"},
    {"tip_m": NEAR},
    {"tip_m": FAR, "path": "line", "tool_speed_m_s": 0.08},
    {"tip_m": NEAR, "path": "arc", "via_m": (0.24, 0.0, 0.12)},
    {"deg": {"wrist_roll": 12.0}, "speed": "slow"},
    {"gripper": "open"},
    {"wait_s": 0.4},
    {"recording": "wave.jsonl"},
    {"motion": {"move_through": {"points_m": [FAR, NEAR], "blend_m": 0.01}}, "speed": "fast"},
    {"motion": {"move_to": {"position_m": NEAR, "stance": {"pitch_rad": -0.9}}}},
    {"motion": {"wait": {"duration_s": 0.1}}},
    {"motion": {"lower": {}}},
)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


def program(*steps, arm="so101", **options):
    return Program(format=1, arm=arm, steps=tuple(ProgramStep(**step) for step in steps), **options)


def run_of(arm, tmp_path, *steps, **options):
    wanted = program(*steps, arm=arm.model.name, **options)
    return ProgramRun(arm, wanted, tmp_path, arm.poses)


def test_every_program_step_kind_survives_write_and_read(tmp_path):
    path = tmp_path / "all.toml"
    written = program(*KINDS, speed="fast", repeat=3)
    write_program(path, written)
    assert read_program(path) == written


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ('format = 1\narm = "so101"\nsteps = []', "steps"),
        ("[[steps]]\nwait_s = 0.0", r"step 1, wait_s"),
        ("[[steps]]\nname = 'x'", r"step 1.*but has none"),
        ("[[steps]]\nwait_s = 1.0\npose = 'home'", "has pose and wait_s"),
        ("[[steps]]\nwait_s = 1.0\npath = 'line'", "which wait_s cannot have"),
        ("[[steps]]\ntip_m = [0.1, 0.2, 0.3]\npath = 'arc'", "via_m"),
        ("[[steps]]\ntip_m = [0.1, 0.2, 0.3]\ntool_speed_m_s = 0.1", "without a line"),
        ("[[steps]]\ntip_m = [0.1, nan, 0.3]", r"step 1, tip_m"),
        ("[[steps]]\npose = 'home'\nspeeed = 'slow'", "speed"),
        ("[[steps]]\npose = 'home'\nmotion.lower = {}", "has pose and motion"),
        ("[[steps]]\ntip_m = [2000.0, 0.2, 0.3]", "step 1: The target position"),
        ("[[steps]]\nmotion.hop = {}", "step 1, motion: There is no motion named 'hop'"),
        (
            "[[steps]]\nmotion.move_through = {}",
            "step 1, motion: move_through lacks the field points_m",
        ),
        ("[[steps]]\nmotion.move_to = { position_m = [0.1] }", "target position"),
        ("[[steps]]\nmotion.move_to = { position_m = [0.2, 0, 0.1], speed = 'slow' }", "the step"),
        ("[[steps]]\nmotion.wait = { duration_s = 0.0 }", "step 1, motion: The wait is 0 s"),
    ],
)
def test_malformed_program_is_refused_naming_the_key(tmp_path, text, expected):
    path = tmp_path / "bad.toml"
    head = "" if not text or "format" in text else 'format = 1\narm = "so101"\n'
    path.write_text(head + text)
    with pytest.raises(FileFormatError, match=expected) as raised:
        read_program(path)
    assert not str(raised.value).endswith("..")


def test_program_step_uses_its_own_or_the_program_speed(arm):
    own, of_program, without = (
        program({"motion": each, **more}, speed="slow")
        for each, more in (
            ({"draw": {"strokes_m": [[NEAR]]}}, {"speed": "fast"}),
            ({"draw": {"strokes_m": [[NEAR]]}}, {}),
            ({"wait": {"duration_s": 1.0}}, {}),
        )
    )
    speeds = [
        getattr(each.steps[0].to_motion(arm.model, each.speed_of(each.steps[0])), "speed", None)
        for each in (own, of_program, without)
    ]
    assert speeds == ["fast", "slow", None]


def test_a_program_of_another_arm_is_refused(arm, tmp_path):
    other = program(*KINDS[:1]).model_copy(update={"arm": "koch"})
    with pytest.raises(BadValueError, match="koch"):
        ProgramRun(arm, other, tmp_path, arm.poses)


def test_program_check_plans_all_steps_and_moves_nothing(arm, tmp_path):
    write_wave_recording("so101", tmp_path / "wave.jsonl")
    before = registers(arm, "goal_position"), registers(arm, "torque_enable")
    checks = list(run_of(arm, tmp_path, *KINDS, repeat=2).check())
    assert [each.error for each in checks] == [None] * (len(KINDS) + 1)
    assert before == (registers(arm, "goal_position"), registers(arm, "torque_enable"))


@pytest.mark.parametrize(
    ("step", "kind"),
    [
        ({"tip_m": (0.9, 0.0, 0.1)}, UnreachableError),
        ({"tip_m": (0.2, 0.0, -0.1)}, IkservoError),
        ({"pose": "nowhere"}, IkservoError),
        ({"deg": {"elbow": 1.0}}, IkservoError),
        ({"m": {"wrist_roll": 1.0}}, BadValueError),
        ({"gripper": 0.5}, IkservoError),
        ({"recording": "missing.jsonl"}, FileFormatError),
    ],
)
def test_program_check_names_impossible_step_and_continues(arm, tmp_path, step, kind):
    checks = list(run_of(arm, tmp_path, KINDS[1], step, KINDS[0]).check())
    assert [each.error is None for each in checks] == [True, False, True]
    assert isinstance(checks[1].error, kind)


def test_line_step_is_checked_from_end_of_previous_step(arm, tmp_path):
    """From home this line is free; from the other side it goes through the arm's own base."""
    line = {"tip_m": (-0.15, 0.15, 0.1), "path": "line"}
    alone = list(run_of(arm, tmp_path, {"tip_m": (-0.12, 0.18, 0.1)}, line).check())
    assert alone[-1].error is None
    through = list(run_of(arm, tmp_path, {"tip_m": (0.2, -0.15, 0.1)}, line).check())
    assert through[-1].number == 2
    assert through[-1].error is not None


def run_steps(run, first=1, on_progress=None):
    """Run the steps one after the other, and yield each when it has ended."""
    for step in run.steps(first):
        run.run_step(step, on_progress)
        yield step


@pytest.mark.full
def test_program_steps_run_in_order_and_reach_last_target(arm, tmp_path):
    write_wave_recording("so101", tmp_path / "wave.jsonl")
    steps = (*KINDS, KINDS[0], {"tip_m": NEAR}, {"tip_m": FAR, "path": "line"})
    made = list(run_steps(run_of(arm, tmp_path, *steps)))
    assert [each.number for each in made] == list(range(1, len(steps) + 1))
    assert np.linalg.norm(true_tip_m(arm) - FAR) < 0.003


@pytest.mark.full
def test_program_started_at_step_2_repeats_from_step_1(arm, tmp_path):
    steps = [{"deg": {"wrist_roll": angle}} for angle in (2.0, 4.0, 6.0)]
    made = list(run_steps(run_of(arm, tmp_path, *steps, repeat=2), 2))
    assert [(each.repetition, each.number) for each in made] == [
        (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)
    ]  # fmt: skip


@pytest.mark.parametrize("number", [0, 4, -1])
def test_program_start_at_missing_step_is_refused(arm, tmp_path, number):
    with pytest.raises(BadValueError, match="1 to 3"):
        list(run_steps(run_of(arm, tmp_path, *KINDS[:3]), number))


@pytest.mark.full
def test_stop_ends_wait_step_of_program(arm, tmp_path):
    run = run_steps(run_of(arm, tmp_path, KINDS[1], {"wait_s": 3600.0}))
    next(run)
    arm.stop("Stopped by another terminal.")
    begin_s = clock_of(arm).now_s()
    with pytest.raises(RefusedError, match="another terminal"):
        next(run)
    assert clock_of(arm).now_s() - begin_s < 1.0


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_supply_voltage_drop_during_wait_step_stops_program(tmp_path, name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        run = run_steps(run_of(arm, tmp_path, {"deg": {"wrist_roll": 2.0}}, {"wait_s": 60.0}))
        next(run)
        line = line_of(arm)
        line.faults.add(Fault("voltage", volts=3.6, at_s=line.world.time_s + 0.5))
        begin_s = clock_of(arm).now_s()
        with pytest.raises(ServoAlarmError, match=r"supply|voltage"):
            next(run)
        assert clock_of(arm).now_s() - begin_s < 3.0


@pytest.mark.full
def test_program_wait_step_ends_after_its_duration(arm, tmp_path):
    steps = [{"wait_s": 1.0}, {"deg": {"wrist_roll": 2.0}}, {"wait_s": 4.0}]
    assert len(list(run_steps(run_of(arm, tmp_path, *steps)))) == 3


TWENTY = [
    {"wait_s": 0.05},
    {"wait_s": 0.05},
    {"deg": {"shoulder_pan": 6.0, "wrist_roll": -3.0}},
    {"deg": {"shoulder_pan": -6.0, "wrist_roll": 12.0}},
] * 5
FAULTS = {
    "a stop": None,
    "a silent servo": ("silent", {"id": 3, "for_s": 0.5}),
    "a reset": ("reset", {"id": 5}),  # without its shoulder, or its supply, the arm would fall
    "a jam": ("stuck", {"id": 1, "for_s": 2.0}),
    "a pulled cable": ("unplug", {"for_s": 0.5}),
}


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", FAULTS)
def test_fault_in_program_of_20_steps_needs_acknowledgement(arm, tmp_path, monkeypatch, name):
    run, made, begun = run_of(arm, tmp_path, *TWENTY, speed="fast"), [], []

    def fail(_):
        if len(made) == 6 and not begun:
            begun.append(name)
            cause(arm, FAULTS[name])

    steps = run_steps(run, on_progress=fail)
    with pytest.raises((IkservoError, StoppedError)):
        collect(made, steps)
    assert [each.number for each in made] == list(range(1, 7))
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 2.5)
    if name == "a pulled cable":
        reconnect(arm, monkeypatch)
    stands = registers(arm, "goal_position")
    with pytest.raises(RefusedError):
        next(run_steps(run, 7))
    assert registers(arm, "goal_position") == stands
    arm.acknowledge()
    assert len(list(run_steps(run, 7))) == 14
    assert abs(math.degrees(true_joints(arm)["wrist_roll"]) - 12.0) < 1.0


def reconnect(arm, monkeypatch):
    """Reconnect the same simulated servos."""
    transport = transport_of(arm)
    again = "ikservo.hardware.port_names.open_transport"
    monkeypatch.setattr(again, lambda *_: setattr(transport, "is_open", True) or transport)
    arm.reconnect(within_s=5.0)


def collect(made, steps):
    """Append each completed step to a list."""
    for step in steps:
        made.append(step)  # what was made before an error counts


def cause(arm, fault):
    """Stop the arm, or start a fault of the given kind with its details."""
    if fault is None:
        arm.stop("Stopped by another terminal.")
        return
    kind, details = fault
    line = line_of(arm)
    line.faults.add(Fault(kind, at_s=line.world.time_s, **details))


def test_look_at_step_is_read_and_described(tmp_path):
    path = tmp_path / "looks.toml"
    step = "motion.look_at = { point_m = [1.0, 0.5, 0.3] }"
    path.write_text(f'format = 1\narm = "so101"\n[[steps]]\nspeed = "slow"\n{step}\n')
    (found,) = read_program(path).steps
    assert found.to_motion(ikservo.load_model("so101"), "slow") == LookAt(
        (1.0, 0.5, 0.3), speed="slow"
    )
    assert found.description == "look at (1.000, 0.500, 0.300) m"

"""Assign servos to joints: each servo moves a little, and the user says which joint moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ikservo.apps.importing.draft import ArmDraft, DraftServo
from ikservo.apps.importing.folder import load_draft
from ikservo.arm.stoppable_bus import stoppable
from ikservo.errors import InputError, ServoSilentError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.goal_writing import write_goals
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.port_choice import choose_port, simulated_port_url
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, scan_rate
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import nearest_goal, read_goal_range, torque_off, torque_on
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Entry,
    EntryDialogue,
    Notice,
    Progress,
    Question,
    Unasked,
)
from ikservo.model.servo_torque import nominal_supply_v
from ikservo.model.tool import describe_direction

_TEST_DEG = 8.0
_STEPS, _STEP_S, _PAUSE_S = 40, 0.025, 0.5
_AGAIN, _NOTHING = "again", "nothing"
_OPTION = "--servo JOINT=ID for each joint"


def parse_servo(text: str) -> DraftServo:
    """Parse ``[-]ID[:MODEL]``; with a minus, ticks fall while the joint position rises.

    Raises:
        ValueError: The id is not a valid servo id.
    """
    number, _, model = text.partition(":")
    servo_id = int(number)
    if not 0 < abs(servo_id) < 253:
        raise ValueError
    return DraftServo(abs(servo_id), model, -1 if servo_id < 0 else 1)


def assign_servos(
    drafts: Sequence[ArmDraft], port: str, given: Mapping[str, Sequence[DraftServo]]
) -> EntryDialogue[None]:
    """Assign the servos of a bus to the joints of drafts that have the pose ``home``.

    Servos by joint that the user has ``given`` are not moved.

    Raises:
        PortError: The port cannot be opened.
        ServoSilentError: No servo replies, or a servo that the user gave does not reply.
        InputError: The servos are of several families or of an unknown model, or too few.
    """
    name = simulated_port_url(choose_port(port), None)
    rates = candidate_baud_rates()
    with open_port(name, rates[0]) as line:
        found = yield from _scan(line, rates)
        assigned = {joint: list(servos) for joint, servos in given.items()}
        joints = {joint.name: draft for draft in drafts for joint in draft.joints}
        _check_servos(found, joints, assigned)
        named = {servo.id for servos in assigned.values() for servo in servos}
        left = [each for each in found if each.id not in named]
        if left and len(assigned) < len(joints):
            yield Notice("Hold the arm near this pose, in which it has room to move a little:")
            for draft in drafts:
                model = load_draft(draft)
                at = model.pose("home")
                pose = ", ".join(f"{j.name} {j.joint_map.format(at[j.name])}" for j in model.joints)
                yield Notice(f"  {draft.name}: {pose}")
            specs = [ServoSpec(each.id, each.table) for each in found if each.table]
            with stoppable(ServoBus(line, specs)) as bus:
                for servo in left:
                    yield from _ask_about(bus, servo, joints, assigned)
    missing = [joint for joint in joints if joint not in assigned]
    if missing:
        hint = f"Check the cable of its servo, or give {_OPTION}."
        raise InputError(f"No servo moves {', '.join(missing)}.", hint)
    for draft in drafts:
        _set_servos(draft, assigned, found)


def _scan(line: Port, rates: Sequence[int]) -> EntryDialogue[list[FoundServo]]:
    """Search the bus at each rate until servos reply."""
    for rate in rates:
        yield Progress(f"searching for servos at {rate} baud")
        found = scan_rate(line, rate)
        if found:
            line.setBaudRate(rate)
            listed = ", ".join(f"{each.id} ({each.model})" for each in found)
            yield Notice(f"Servos on the bus, at {rate} baud: {listed}.")
            return found
    raise ServoSilentError("No servo replies", "Check the servos' power supply and the cable.")


def _check_servos(
    found: Sequence[FoundServo],
    joints: Mapping[str, ArmDraft],
    given: Mapping[str, Sequence[DraftServo]],
) -> None:
    unknown = [str(each) for each in found if each.table is None or each.shares_id]
    if unknown:
        hint = "Give each servo its own id: ikservo setup. Unknown models are not supported yet."
        raise InputError(f"Not usable: {'; '.join(unknown)}.", hint)
    families = {each.table.family.value for each in found if each.table}
    if len(families) > 1:
        raise InputError(f"The servos belong to several families: {', '.join(sorted(families))}.",
                         "All servos of an arm must belong to one family.")  # fmt: skip
    if len(found) < len(joints):
        raise InputError(
            f"{len(found)} servos reply, but the arm has {len(joints)} joints: "
            f"{', '.join(joints)}.",
            "Connect all servos, or leave joints out: --gripper none, --tip LINK.",
        )
    ids = {each.id for each in found}
    for joint, servos in given.items():
        for servo in servos:
            if servo.id not in ids:
                raise ServoSilentError(
                    f"Servo {servo.id} of {joint} does not reply", f"Check: {_OPTION}"
                )


def _ask_about(
    bus: ServoBus,
    servo: FoundServo,
    joints: Mapping[str, ArmDraft],
    assigned: dict[str, list[DraftServo]],
) -> EntryDialogue[None]:
    """Move a servo a little and back; ask which joint moved, and in which direction."""
    question = f"Servo {servo.id} ({servo.model}) moves by {_TEST_DEG:.0f}° and back. Move it?"
    if (yield Question(question, Unasked.NO)) != ACCEPT:
        raise InputError(f"Servo {servo.id} was not moved.", f"Name the servos: {_OPTION}")
    answer = _AGAIN
    while answer == _AGAIN:
        yield from _move_and_return(bus, servo.id)
        answer = yield Entry("Which joint moved?", _OPTION, choices=(*joints, _AGAIN, _NOTHING))
    if answer is None or answer == _NOTHING:
        return
    draft = joints[answer]
    model = load_draft(draft)
    direction = describe_direction(model, model.joint(answer), "home", 1)
    way = ""
    while way not in ("yes", "no"):
        asked = f"Did it first move {direction}? ({_AGAIN} moves it once more)"
        way = yield Entry(asked, _OPTION, choices=("yes", "no", _AGAIN))
        if way == _AGAIN:
            yield from _move_and_return(bus, servo.id)
    sign = 1 if way == "yes" else -1
    assigned.setdefault(answer, []).append(DraftServo(servo.id, servo.model, sign))
    yield Notice(f"{answer}: servo {servo.id}, which counts {'with' if sign > 0 else 'against'} "
                 "the axis.")  # fmt: skip


def _move_and_return(bus: ServoBus, servo_id: int) -> EntryDialogue[None]:
    """Move a servo slowly, towards increasing ticks, and back, then switch its torque off again.

    Each step is reported, so that the caller of the dialogue can end it at any step.
    """
    spec = bus.servos[servo_id]
    travel = round(spec.table.ticks_per_turn * _TEST_DEG / 360.0)
    accepted = read_goal_range(bus, servo_id)
    start = torque_on(bus, servo_id)
    try:
        for step in (*range(1, _STEPS + 1), *([_STEPS] * round(_PAUSE_S / _STEP_S)),
                     *reversed(range(_STEPS))):  # fmt: skip
            goal = nearest_goal(str(spec), start + round(travel * step / _STEPS), accepted)
            bus.check_may_move()
            write_goals(bus, {servo_id: goal}, {servo_id: accepted})
            bus.clock.sleep_until(bus.clock.now_s() + _STEP_S)
            yield Progress(f"moving servo {servo_id}")
    finally:
        for error in torque_off(bus, [servo_id]).values():
            raise error


def _set_servos(
    draft: ArmDraft, assigned: Mapping[str, Sequence[DraftServo]], found: Sequence[FoundServo]
) -> None:
    models = {each.id: each.model for each in found}
    draft.joints = tuple(
        replace(
            joint,
            servos=tuple(replace(servo, model=models[servo.id]) for servo in assigned[joint.name]),
        )
        for joint in draft.joints
    )
    draft.baud = found[0].baud_rate
    voltages = [each.voltage_v for each in found if each.voltage_v is not None]
    model = draft.joints[0].servos[0].model
    usual_v = nominal_supply_v(model, None)
    if model == "STS3215":  # sold for 7.4 V and for 12 V
        draft.supply_v = 12.0 if voltages and voltages[0] > 9.5 else usual_v
    else:
        draft.supply_v = None
    draft.decisions.append("Each servo on the bus was assigned by its motion, or by --servo.")

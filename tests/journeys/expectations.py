"""Allowed exit codes and end states of every command and method, on any arm in any posture."""

import re

import numpy as np

from tests.journeys.command_arguments import BY_HAND, FILED, usual_target_m
from tests.journeys.method_arguments import methods, parameters
from tests.oracle import ARMS, tip_from_joints

MOVING = ("move", "arc", "draw", "test", "joints", "jog", "gripper", "pose", "replay", "follow",
          "relax", "identify", "program", "pick")  # fmt: skip
ONE_JOINT = ("joints", "jog", "gripper", "move_joints", "plan", "plan_joints", "stream")
CARTESIAN = ("arc", "draw", "move_arc", "move_line", "plan_arc", "plan_line")
PASSIVE = (  # methods that neither move the arm nor plan a motion, or disable its torque anyway
    "acknowledge", "close", "disable_torque", "enable", "hold", "pose_within_limits", "record",
    "relax", "request_stop", "stop", "teach", "where",
)  # fmt: skip
# Commands that say that torque comes on, or move the arm. All others leave a limp arm limp.
ENABLING = (
    *MOVING, *(name for name in methods() if "wait" in {each.name for each in parameters(name)}),
    "enable", "execute", "follow_arm", "follow_goals", "hold", "return_within_limits", "stream",
    "teach",
)  # fmt: skip
LIMP_AFTERWARDS = ("relax", "disable_torque")
STABLE = ("rest, sunk", "pose rest")  # a limp arm stays there; from others it falls
NEAR_M, NEAR_DEG = 0.003, 1.5
INTERNALS = re.compile(r"Traceback|np\.\w|array\(|<[\w.]+ object|\bNone\b|\w+Error\(|\bnan\b")
BLOCKED = re.compile(
    r"collision|would collide|would touch|does not follow|found nothing", re.IGNORECASE
)


def parameter_names(what):
    """Return the names of the parameters of a case: ``what`` is the command or method."""
    return ("arm", what, "posture", "kind")


def on_every_arm(of):
    """Return the cases (arm, what, posture, kind of port) of every arm."""
    return [(arm, *case) for arm in ARMS for case in of(arm)]


def isolate_user_files(monkeypatch, folder):
    """Use an empty user folder: no calibration, no remembered port."""
    monkeypatch.setenv("IKSERVO_HOME", str(folder / "home"))
    monkeypatch.setenv("COLUMNS", "80")


def allowed_command_codes(command, kind, posture, model):
    """Return the allowed exit codes of a command; all others are defects."""
    allowed = {0}
    if command in BY_HAND:
        allowed = {2, 4, 6}  # there is no operator, and the exit code says what was missing
    if command == "calibrate" and kind == "sim":
        allowed |= {0}  # a hand of the simulator moves it
    if command == "fleet":
        allowed = {3}  # there is no machine
    if command in FILED and kind != "real, calibrated":
        allowed |= {6}
    if command in MOVING and kind == "real, uncalibrated" and _zeros_unknown(model):
        allowed |= {6}
    if command == "gripper" and kind == "real, uncalibrated" and _zeros_unknown(model):
        allowed |= {1}  # the jaws stop at the arm's own base, which it believes to be elsewhere
    if command == "pick":  # nothing is there, no grasp may be possible, or the gripper is missing
        allowed |= {1, 7, 8}
    if command == "gripper" and model.gripper is None:
        allowed = {1, 2}
    if command == "relax" and posture not in STABLE:
        allowed |= {1}  # torque off where it lies, because its path to the rest pose is blocked
    elif command in MOVING:
        allowed |= _allowed_cartesian_codes(command, posture)
        allowed |= allowed_blocked_codes(posture, one_joint=command in ONE_JOINT)
    return allowed


def allowed_method_codes(method, posture, machine):
    """Return the allowed exit codes of a method's errors; all others are defects."""
    allowed = {0}
    if method == "last_state":  # has no state before the first motion
        return {1}
    if method == "gripper" and machine.model.gripper is None:
        return {1, 2}
    if not machine.zeros.are_known:
        allowed |= {6}
    allowed |= _allowed_cartesian_codes(method, posture)
    if method not in PASSIVE:
        allowed |= allowed_blocked_codes(posture, one_joint=method in ONE_JOINT)
    return allowed


def _allowed_cartesian_codes(what, posture):
    """Return the exit codes of a motion along a path that begins at the posture."""
    if what not in CARTESIAN:
        return set()
    # The joints may be unable to follow the path from the posture. At rest the gripper lies on
    # the table: a slanting path lifts it by less than the joints sag under the arm's weight, so it
    # would drag along the table for the first centimetre.
    return {7, 8} if posture == "rest, sunk" else {7}


def allowed_blocked_codes(posture, *, one_joint):
    """Return the exit code of a blocked motion if the posture allows one.

    A limp arm falls from most postures onto itself or the table. From its rest pose every path is
    free; but one joint moved alone may press on the table.
    """
    return {8} if posture not in STABLE or one_joint else set()


def find_faults(command, bench, model, result, allowed, posture):
    """Return the faults of the output and the end state; empty if there are none.

    Args:
        command: The command, or the one that does the same as a method.
        bench: The arm on its port.
        model: The arm.
        result: The output and the exit code.
        allowed: The allowed exit codes.
        posture: The posture of the limp arm at the start.
    """
    wrong = list(find_text_faults(result))
    if result.code not in allowed:
        wrong.append(f"exit code {result.code}")
    wrong += find_torque_faults(command, bench, posture)
    blocked = result.code == 8 or (command == "relax" and result.code == 1)
    if blocked and not BLOCKED.search(result.out + result.err):
        wrong.append("refused without naming a collision")
    if bench.world is not None and (result.code == 0 or command == "relax"):
        wrong += find_state_faults(command, bench, model)
    return wrong


def find_torque_faults(command, bench, posture):
    """Yield servos whose torque came on unannounced, or with a goal away from the joint."""
    if bench.watch.enablings and command not in ENABLING:
        yield f"switched torque on: {bench.watch.enablings}"
    if posture in STABLE:  # elsewhere it falls
        yield from (f"would jump: {found}" for found in bench.watch.enablings if found.jumps)
    if command in LIMP_AFTERWARDS and bench.world is not None and any(bench.torque().values()):
        yield f"torque is on after {command}"


def find_text_faults(result):
    """Yield the faults of both output streams."""
    text = result.out + result.err
    if INTERNALS.search(text):
        yield f"internals in the output: {INTERNALS.search(text).group()}"
    if result.code and len(result.err.strip().splitlines()) < 1:
        yield "failed without a message"


def find_state_faults(command, bench, model):
    """Yield the faults of the simulated joints and their torque."""
    joints = bench.joints()
    if bench.kind == "real, uncalibrated":
        return
    if command == "move":
        tip = tip_from_joints(bench.arm, joints)
        off_m = float(np.linalg.norm(tip - usual_target_m(bench.arm)))
        if off_m > NEAR_M:
            yield f"the true tip is {1000 * off_m:.1f} mm from the target"
    if command == "pose":
        yield from _off_pose(model, joints, model.pose("home"))


def _off_pose(model, joints, expected):
    for joint in model.joints:
        off = abs(joints[joint.name] - expected[joint.name]) / joint.travel_per_turn * 360
        if off > NEAR_DEG:
            yield f"{joint.name} is {off:.1f} degrees of its servo from the pose"


def _zeros_unknown(model):
    return any(joint.zero_from != "vendor" for joint in model.joints)

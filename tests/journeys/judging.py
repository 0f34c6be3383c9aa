"""What every command and every method owes a person, whatever arm it meets and however it lies."""

import re

import numpy as np

from tests.journeys.typed import BY_HAND, FILED, usual_target_m
from tests.oracle import ARMS, tip_from_joints

MOVING = ("move", "joints", "jog", "gripper", "pose", "replay", "follow", "relax")
ONE_JOINT = ("joints", "jog", "gripper", "move_joints", "plan_joints", "stream")
LINES_OF_TIP = ("move_line", "plan_line")
CALM = (  # methods that neither move the arm nor plan a motion, or let it go in any case
    "acknowledge", "close", "disable_torque", "enable", "hold", "pose_within_limits", "record",
    "relax", "request_stop", "stop", "teach", "where",
)  # fmt: skip
STILL = ("rest, sunk", "pose rest")  # a limp arm stays there; from others it falls
NEAR_M, NEAR_DEG = 0.003, 1.5
INTERNALS = re.compile(r"Traceback|np\.\w|array\(|<[\w.]+ object|\bNone\b|\w+Error\(|\bnan\b")
BLOCKED = re.compile(r"collision|would collide|does not follow", re.IGNORECASE)


def names_of(what):
    """Return the names of the parameters of a case: ``what`` is what is tried."""
    return ("arm", what, "posture", "kind")


def on_every_arm(of):
    """Return the cases (what, posture, kind of line) of every arm, the arm before each."""
    return [(arm, *case) for arm in ARMS for case in of(arm)]


def at_home(monkeypatch, folder):
    """Let nothing that was calibrated or remembered before be known."""
    monkeypatch.setenv("IKSERVO_HOME", str(folder / "home"))
    monkeypatch.setenv("COLUMNS", "80")


def codes_of_command(command, kind, posture, model):
    """Return the exit codes that a person may meet; all others are defects."""
    allowed = {0}
    if command in BY_HAND:
        allowed = {2, 4, 6}  # nobody is there, and the exit code says what was missing
    if command in FILED and kind != "real, calibrated":
        allowed |= {6}
    if command in MOVING and kind == "real, uncalibrated" and _zeros_unknown(model):
        allowed |= {6}
    if command == "gripper" and model.gripper is None:
        allowed = {1, 2}
    if command == "relax" and posture not in STILL:
        allowed |= {1}  # let go where it lies, for something is in its way to the rest pose
    elif command in MOVING:
        allowed |= codes_if_blocked(posture, one_joint=command in ONE_JOINT)
    return allowed


def codes_of_method(method, posture, machine):
    """Return the exit codes of the errors that a program may meet; all others are defects."""
    allowed = {0}
    if method == "last_state":  # has nothing to tell before the first motion
        return {1}
    if method == "gripper" and machine.model.gripper is None:
        return {1, 2}
    if not machine.zeros.are_known:
        allowed |= {6}
    if method in LINES_OF_TIP:
        allowed |= {7}  # from where the arm lies the joints need not be able to keep to a line
        if posture == "rest, sunk":
            # The gripper lies on the table. A slanting line lifts it by less than the joints sag
            # under the arm's weight, so it would drag along the table for the first centimetre.
            allowed |= {8}
    if method not in CALM:
        allowed |= codes_if_blocked(posture, one_joint=method in ONE_JOINT)
    return allowed


def codes_if_blocked(posture, *, one_joint):
    """Return the exit code of a motion that something is in the way of, where that may be.

    A limp arm falls from most postures, and comes to lie on itself or on the table. From its rest
    it gets up to any place; but one joint alone, turned there, may press on the table.
    """
    return {8} if posture not in STILL or one_joint else set()


def faults(command, bench, model, said, allowed):
    """Return what was wrong with what was said and done, in words; empty for a sound end.

    Args:
        command: What was tried; a method goes by the command that does the same.
        bench: The arm on its line.
        model: The arm.
        said: What it said, and its exit code.
        allowed: The exit codes that may be.
    """
    wrong = list(words(said))
    if said.code not in allowed:
        wrong.append(f"exit code {said.code}")
    blocked = said.code == 8 or (command == "relax" and said.code == 1)
    if blocked and not BLOCKED.search(said.out + said.err):
        wrong.append("refused, and nothing was in the way")
    if bench.world is not None and (said.code == 0 or command == "relax"):
        wrong += deeds(command, bench, model)
    return wrong


def words(said):
    """Yield what was wrong with the words on both streams."""
    text = said.out + said.err
    if INTERNALS.search(text):
        yield f"internals in the words: {INTERNALS.search(text).group()}"
    if said.code and len(said.err.strip().splitlines()) < 1:
        yield "failed without a word"


def deeds(command, bench, model):
    """Yield what was wrong with where the simulated joints are and what holds them."""
    joints = bench.joints()
    if command == "relax" and any(bench.torque().values()):
        yield "torque is still on after relax"
    if bench.kind == "real, uncalibrated":
        return
    if command == "move":
        tip = tip_from_joints(bench.arm, joints)
        off_m = float(np.linalg.norm(tip - usual_target_m(bench.arm)))
        if off_m > NEAR_M:
            yield f"the true tip is {1000 * off_m:.1f} mm beside the target"
    if command == "pose":
        yield from _beside(model, joints, model.pose("home"))


def _beside(model, joints, wanted):
    for joint in model.joints:
        off = abs(joints[joint.name] - wanted[joint.name]) / joint.travel_per_turn * 360
        if off > NEAR_DEG:
            yield f"{joint.name} is {off:.1f} degrees of its servo beside the pose"


def _zeros_unknown(model):
    return any(joint.zero_from != "vendor" for joint in model.joints)

"""What every command and every method owes a person, whatever arm it meets and however it lies."""

import re

import numpy as np

from ikservo.model import load_model
from tests.journeys.typed import BY_HAND, FILED, usual_target_m
from tests.oracle import tip_from_joints

MOVING = ("move", "joints", "jog", "gripper", "pose", "replay", "follow", "relax")
STILL = ("rest, sunk", "pose rest")  # a limp arm stays there; from others it falls
NEAR_M, NEAR_DEG = 0.003, 1.5
INTERNALS = re.compile(r"Traceback|np\.\w|array\(|<[\w.]+ object|\bNone\b|\w+Error\(|\bnan\b")
BLOCKED = re.compile(r"collision|would collide|does not follow", re.IGNORECASE)


def codes_allowed(command, kind, posture, model):
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
    if command in MOVING and command != "relax" and posture not in STILL:
        allowed |= {8}
    return allowed


def faults(command, bench, posture, said):
    """Return what was wrong with what a command said and did, in words; empty for a sound one."""
    model = load_model(bench.arm)
    wrong = list(words(said))
    if said.code not in codes_allowed(command, bench.kind, posture, model):
        wrong.append(f"exit code {said.code}")
    if said.code == 8 and not BLOCKED.search(said.err):
        wrong.append("refused, and nothing was in the way")
    if said.code == 0 and bench.world is not None:
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

"""``ikservo calibrate``: this arm's own zeros, signs and ranges, by hand or by itself."""

from __future__ import annotations

import math
import sys

from ikservo.cli.calibrating.by_itself import by_itself
from ikservo.cli.calibrating.hands import Wishes, by_hand, own_limits
from ikservo.cli.calibrating.options import (
    ArmWord,
    Auto,
    Block,
    Free,
    FromScript,
    Margin,
    NoInput,
    OnlyJoint,
    OwnLimit,
    Points,
    Pose,
    SamePoint,
    SheetAt,
    Skip,
    TouchOff,
    Wiggle,
    WriteLimits,
)
from ikservo.cli.calibrating.touch import TouchWishes, touch_off
from ikservo.cli.calibrating.wiggle import wiggle_all
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import JsonOption, PortOption, UncalibratedOption, YesOption
from ikservo.cli.session import opened
from ikservo.errors import InputError

__all__ = ["command"]


def command(
    arm: ArmWord = None,
    *,
    port: PortOption = None,
    pose: Pose = "rest",
    margin: Margin = 2.0,
    free: Free = None,
    skip: Skip = None,
    joint: OnlyJoint = None,
    limit: OwnLimit = None,
    write_limits: WriteLimits = None,
    auto: Auto = False,
    wiggle: Wiggle = False,
    touch: TouchOff = False,
    points: Points = None,
    same_point: SamePoint = False,
    sheet_at: SheetAt = None,
    block: Block = None,
    uncalibrated: UncalibratedOption = False,
    from_script: FromScript = None,
    yes: YesOption = False,
    no_input: NoInput = False,
    json: JsonOption = False,
) -> None:
    """Find an arm's zeros, signs and ranges, moving it by hand; torque is off meanwhile.

    ikservo calibrate so101

    ikservo calibrate so101 --pose home --margin 1 --write-limits

    ikservo calibrate so101 --joint elbow_flex        this joint again, the others are kept

    ikservo calibrate so101 --auto          the arm finds its stops itself

    ikservo calibrate so101 --touch         then: the tip on a printed sheet, for millimetres
    """
    if auto + touch + wiggle > 1:
        raise InputError("One of --auto, --touch and --wiggle at a time.")
    if joint and (auto or touch):
        raise InputError("--joint goes with a calibration by hand or with --wiggle.")
    if wiggle:
        with opened(arm, port, collisions=False, uncalibrated=uncalibrated) as machine:
            wiggle_all(machine, joint or [], yes=yes, json=json)
        return
    model = chosen_model(arm)
    asks = not (yes or no_input or from_script) and sys.stdin.isatty()
    if touch:
        wanted = TouchWishes(points, same_point, sheet_at, block)
        touch_off(model, port, wanted, from_script, yes=yes, asks=asks, json=json)
        return
    if points or same_point or sheet_at is not None or block is not None:
        raise InputError("Points are touched in a touch-off only.", "Add: --touch")
    user = own_limits(model, limit or [])
    wishes = Wishes(
        pose=pose,
        margin_rad=math.radians(margin),
        free=free or [],
        skip=skip or [],
        joints=[model.joint(name).name for name in joint or []],
        user=user,
        write_limits=write_limits,
        yes=yes,
        asks=asks,
        json=json,
    )
    (by_itself if auto else by_hand)(model, port, wishes, from_script)

"""``ikservo test --touch``: measure accuracy by guiding the tip by hand to known points."""

from __future__ import annotations

from pathlib import Path

from ikservo.apps.calibrating.by_hand_dialogue import switch_torque_off
from ikservo.apps.calibrating.calibrate_by_hand import print_servos
from ikservo.apps.calibrating.calibrate_touch import TouchOffOptions, make_targets
from ikservo.apps.calibrating.calibration_session import open_torque_off
from ikservo.apps.calibrating.kinematic_calibration import TouchPoint
from ikservo.apps.calibrating.touch_dialogue import touch_points
from ikservo.apps.calibrating.touch_off import TouchOffSession
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import CalibrationError, IkservoError
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model


class TouchedPoints:
    """The touches of an accuracy test; they are kept if the test is stopped.

    Attributes:
        tips: Name and position (3,) of each touched point, and the position (3,) of the tip from
            the measured joint positions; metres, base frame.
        stopped: The reason why the test ended early; None if it is complete.
    """

    def __init__(self) -> None:
        self.tips: list[tuple[str, Vector, Vector]] = []
        self.stopped: BaseException | None = None


def measure_by_touch(
    model: Model, port: str | None, points: Path | None, times: int, operator: Operator
) -> TouchedPoints:
    """Switch torque off and let the user put the tip on known points.

    Without a file, the known points are the points of the printed sheet.

    Raises:
        CalibrationError: The arm is not calibrated, or no point was touched.
        InputError: There is no user to answer.
    """
    found = TouchedPoints()
    with open_torque_off(model, port) as limp_arm:
        session = TouchOffSession(limp_arm)
        targets = session.reachable_targets(make_targets(model, TouchOffOptions(points=points)))
        if not targets:
            raise CalibrationError("No point is within reach of the tip.", "Check the points.")
        operator.run(switch_torque_off(limp_arm))
        print_servos(limp_arm, "home")
        state = session.start_touch_off(targets * times)
        touches: list[TouchPoint] = []
        try:
            operator.run(touch_points(limp_arm, state, touches))
        except (IkservoError, KeyboardInterrupt) as error:
            found.stopped = error
        found.tips = [
            (touch.point, touch.position_m, session.present.forward(touch.q)[:3, 3])
            for touch in touches
            if touch.position_m is not None
        ]
    if not found.tips and found.stopped is not None:
        raise found.stopped
    if not found.tips:
        raise CalibrationError("No point was touched; there is nothing to report.")
    return found

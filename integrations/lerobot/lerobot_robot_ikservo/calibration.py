"""Calibrate an arm with ikservo's commands, and write the result to LeRobot's file."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import ikservo
from ikservo.arm import ZeroSource
from ikservo.calibration.calibration_file import load_calibration
from ikservo.calibration.lerobot import dump_lerobot, lerobot_joints, lost_in_lerobot
from ikservo.files.writing import write_atomic
from ikservo.hardware.port_names import serial_number_of
from lerobot_robot_ikservo.config import IkservoLeaderConfig, IkservoRobotConfig

__all__ = ["calibrate_arm", "calibration_command", "write_lerobot_file"]

_LOG = logging.getLogger(__name__)


def calibrate_arm(config: IkservoRobotConfig | IkservoLeaderConfig) -> None:
    """Calibrate an arm in this terminal; its port must be closed.

    Raises:
        CalibrationError: The command failed and has printed the reason.
    """
    if config.port.partition(":")[0] == "sim":
        _LOG.info("The simulated arm needs no calibration.")
        return
    done = subprocess.run(calibration_command(config), check=False)
    if done.returncode:
        raise ikservo.CalibrationError(
            f"The calibration ended with exit code {done.returncode}; nothing was saved."
        )


def calibration_command(config: IkservoRobotConfig | IkservoLeaderConfig) -> list[str]:
    """Return the command line of a calibration by hand or an import of LeRobot's file."""
    given = config.lerobot_calibration
    what = ["import", "lerobot", given, "--arm"] if given else ["calibrate"]
    port = ["--port", config.port] if config.port else []
    yes = ["--yes"] if config.assume_yes else []
    return [sys.executable, "-m", "ikservo", *what, config.arm, *port, *yes]


def write_lerobot_file(arm: ikservo.OpenArm, path: Path) -> bool:
    """Write an arm's calibration to LeRobot's path; return whether there is a calibration."""
    if arm.zeros is not ZeroSource.CALIBRATED:
        return False
    calibration = load_calibration(arm.model.name, serial_number_of(arm.port_name))
    if calibration is None:
        return False
    write_atomic(path, dump_lerobot(lerobot_joints(calibration)))
    for line in lost_in_lerobot(calibration):
        _LOG.info("%s", line)
    return True

"""Whether anybody has seen that the joints of an arm are those its files say.

Ids, models and offsets can agree although two joints are exchanged, a sign is mirrored or the
geometry is another arm's: a servo measures nothing but itself. So what was confirmed by eye is
noted as a fingerprint of everything it rests on, and another fingerprint is asked about anew.
"""

from __future__ import annotations

import contextlib
import hashlib

from ikservo.arm.own import serial_number_of
from ikservo.calibration.filing.store import calibration_path, confirmation_path
from ikservo.files.writing import FileWriteError, write_whole
from ikservo.model import Model

__all__ = ["confirm", "confirmed"]


def confirmed(model: Model, port_name: str) -> bool:
    """Return whether the joints were seen to be right with the files as they are now."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    try:
        return path.read_text("ascii").strip() == _fingerprint(model, port_name)
    except (OSError, ValueError):  # never noted, or spoiled: nobody has seen it
        return False


def confirm(model: Model, port_name: str) -> None:
    """Note that the joints were seen to be right; where no file can be written it is asked anew."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    with contextlib.suppress(FileWriteError):
        write_whole(path, _fingerprint(model, port_name) + "\n")


def _fingerprint(model: Model, port_name: str) -> str:
    """Return a digest of joints, servos, geometry and calibration."""
    path = calibration_path(model.name, serial_number_of(port_name))
    calibration = path.read_bytes() if path.is_file() else b""
    said = repr((model.name, model.joints, model.urdf.joints)).encode("utf-8", "replace")
    return hashlib.sha256(said + b"\0" + calibration).hexdigest()

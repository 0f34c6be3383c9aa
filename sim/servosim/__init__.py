"""A simulated servo bus, written from the datasheets.

>>> import servosim
>>> port = servosim.open_port("sim:/path/to/configs/so101/arm.toml")      # doctest: +SKIP
>>> port.line.servos[1].read("present_position")                          # doctest: +SKIP
2048
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from servosim.arm_file import read_arm_file
from servosim.port import SimulatedPort, open_port

if TYPE_CHECKING:
    from cv2.aruco import CharucoBoard

    from servosim.camera import SimulatedCamera

__all__ = ["SimulatedPort", "open_camera", "open_port", "read_arm_file", "serve"]


def open_camera(port: object, board: CharucoBoard) -> SimulatedCamera | None:
    """Return a camera that sees the arm at a simulated port; None for other ports."""
    from servosim.camera import SimulatedCamera  # noqa: PLC0415 - needs OpenCV

    if not isinstance(port, SimulatedPort):
        return None
    camera = SimulatedCamera(port.line.world, board)
    camera.set_stage()
    return camera


def serve(argv: list[str]) -> int:
    """Serve a simulated bus behind a pseudo-terminal; see ``servosim.server``."""
    from servosim.server import serve as run  # noqa: PLC0415 - a library user needs no terminal

    return run(argv)

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cv2 import aruco as aruco

_Floats = NDArray[np.float64] | NDArray[np.float32]

CAP_FFMPEG: int
CAP_PROP_OPEN_TIMEOUT_MSEC: int
CAP_PROP_READ_TIMEOUT_MSEC: int
COLOR_BGR2GRAY: int
CV_64F: int
CALIB_USE_INTRINSIC_GUESS: int
CALIB_ZERO_TANGENT_DIST: int
CALIB_FIX_K3: int
SOLVEPNP_IPPE: int
INTER_LINEAR: int
INTER_AREA: int
INTER_NEAREST: int
BORDER_REPLICATE: int

class error(Exception): ...

class VideoCapture:
    def __init__(
        self, source: int | str, backend: int = ..., params: Sequence[int] = ...
    ) -> None: ...
    def isOpened(self) -> bool: ...
    def grab(self) -> bool: ...
    def read(self) -> tuple[bool, NDArray[np.uint8] | None]: ...
    def release(self) -> None: ...

IMREAD_COLOR: int

def imdecode(data: NDArray[np.uint8], flags: int) -> NDArray[np.uint8] | None: ...
def imencode(extension: str, image: NDArray[np.uint8]) -> tuple[bool, NDArray[np.uint8]]: ...
def cvtColor(image: NDArray[np.uint8], code: int) -> NDArray[np.uint8]: ...
def Laplacian(image: NDArray[np.uint8], depth: int) -> NDArray[np.float64]: ...
def calibrateCamera(
    points: Sequence[_Floats],
    pixels: Sequence[_Floats],
    size: tuple[int, int],
    matrix: NDArray[np.float64],
    distortion: NDArray[np.float64],
    *,
    flags: int,
) -> tuple[float, NDArray[np.float64], NDArray[np.float64], object, object]: ...
def solvePnPGeneric(
    points: _Floats, pixels: _Floats, matrix: _Floats, distortion: _Floats, *, flags: int
) -> tuple[
    int, Sequence[NDArray[np.float64]], Sequence[NDArray[np.float64]], NDArray[np.float64]
]: ...
def solvePnPRefineLM(
    points: _Floats,
    pixels: _Floats,
    matrix: _Floats,
    distortion: _Floats,
    turn: NDArray[np.float64],
    at: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def undistortPoints(
    pixels: _Floats, matrix: _Floats, distortion: _Floats
) -> NDArray[np.float64]: ...
def remap(
    image: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    interpolation: int,
    *,
    borderMode: int = ...,
) -> NDArray[np.float32]: ...
def resize(
    image: NDArray[np.float32], size: tuple[int, int], *, interpolation: int
) -> NDArray[np.float32]: ...

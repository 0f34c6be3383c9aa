"""Frames on the wire: readers that survive junk, writers, for both framings the servos speak."""

from servosim.frames.dynamixel1 import Dynamixel1Reader, checksum, encode1
from servosim.frames.dynamixel2 import Dynamixel2Reader, crc16, encode2, stuff, unstuff
from servosim.frames.reader import Frame, FrameReader

__all__ = [
    "Dynamixel1Reader",
    "Dynamixel2Reader",
    "Frame",
    "FrameReader",
    "checksum",
    "crc16",
    "encode1",
    "encode2",
    "stuff",
    "unstuff",
]

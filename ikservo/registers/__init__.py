"""What a servo's memory means: one typed table per servo model."""

from __future__ import annotations

from ikservo.registers.alarms import Alarm
from ikservo.registers.codec import SignMagnitude, TwosComplement, Unsigned
from ikservo.registers.dynamixel_1 import AX12A, MX28
from ikservo.registers.dynamixel_x import XL330M077, XL330M288, XL430W250, XM430W350, XM540W270
from ikservo.registers.feetech_scs import SCS0009, SCS15
from ikservo.registers.feetech_sts import STS3215, STS3250
from ikservo.registers.models import MODELS, table_for, table_with_number
from ikservo.registers.register import Access, Area, Register
from ikservo.registers.table import Family, FeetechMode, OperatingMode, Role, ServoTable
from ikservo.registers.units import Unit

__all__ = [
    "AX12A",
    "MODELS",
    "MX28",
    "SCS0009",
    "SCS15",
    "STS3215",
    "STS3250",
    "XL330M077",
    "XL330M288",
    "XL430W250",
    "XM430W350",
    "XM540W270",
    "Access",
    "Alarm",
    "Area",
    "Family",
    "FeetechMode",
    "OperatingMode",
    "Register",
    "Role",
    "ServoTable",
    "SignMagnitude",
    "TwosComplement",
    "Unit",
    "Unsigned",
    "table_for",
    "table_with_number",
]

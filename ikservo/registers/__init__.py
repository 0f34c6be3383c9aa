"""Control tables: one typed table per servo model."""

from __future__ import annotations

from ikservo.registers.control_table import (
    Alarm,
    ControlTable,
    Family,
    FeetechMode,
    OperatingMode,
    RegisterName,
)
from ikservo.registers.dynamixel_1 import AX12A, MX28
from ikservo.registers.dynamixel_x import XL330M077, XL330M288, XL430W250, XM430W350, XM540W270
from ikservo.registers.feetech_scs import SCS0009, SCS15
from ikservo.registers.feetech_sts import STS3215, STS3250
from ikservo.registers.models import MODELS, control_table, control_table_for_number
from ikservo.registers.register import (
    Access,
    Area,
    Register,
    SignMagnitude,
    TwosComplement,
    Unsigned,
)
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
    "ControlTable",
    "Family",
    "FeetechMode",
    "OperatingMode",
    "Register",
    "RegisterName",
    "SignMagnitude",
    "TwosComplement",
    "Unit",
    "Unsigned",
    "control_table",
    "control_table_for_number",
]

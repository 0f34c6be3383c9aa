"""The servos as they are: a port, the vendors' packets, and typed registers on a line."""

from __future__ import annotations

from ikservo.hardware.bus import ServoBus
from ikservo.hardware.keeping.backup import Backup, back_up_once, backup_path, read_backup
from ikservo.hardware.keeping.eeprom import Difference, differences, read_eeprom, update_eeprom
from ikservo.hardware.line.port import Port, open_port
from ikservo.hardware.line.replug import reopen, serial_number_of
from ikservo.hardware.readings import Readings
from ikservo.hardware.servo import Identity, ServoSpec
from ikservo.hardware.torque import check_supply, torque_off, torque_on

__all__ = [
    "Backup",
    "Difference",
    "Identity",
    "Port",
    "Readings",
    "ServoBus",
    "ServoSpec",
    "back_up_once",
    "backup_path",
    "check_supply",
    "differences",
    "open_port",
    "read_backup",
    "read_eeprom",
    "reopen",
    "serial_number_of",
    "torque_off",
    "torque_on",
    "update_eeprom",
]

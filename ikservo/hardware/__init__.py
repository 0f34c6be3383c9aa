"""Access to servos on a bus: serial port, vendor packets, and typed registers."""

from __future__ import annotations

from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import (
    Backup,
    RegisterDifference,
    back_up_once,
    backup_path,
    read_backup,
    read_eeprom,
    register_differences,
    update_eeprom,
)
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.port_names import reconnect, serial_number_of
from ikservo.hardware.servo import PingResult, Readings, ServoSpec
from ikservo.hardware.torque import check_supply_voltage, torque_off, torque_on

__all__ = [
    "Backup",
    "PingResult",
    "Port",
    "Readings",
    "RegisterDifference",
    "ServoBus",
    "ServoSpec",
    "back_up_once",
    "backup_path",
    "check_supply_voltage",
    "open_port",
    "read_backup",
    "read_eeprom",
    "reconnect",
    "register_differences",
    "serial_number_of",
    "torque_off",
    "torque_on",
    "update_eeprom",
]

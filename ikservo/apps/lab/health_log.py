"""Health of an arm's servos over time: a record of each measurement, and signs of wear.

``health/<arm>-<adapter>.jsonl`` in the user's folder has a line per run of `ikservo monitor` and
`ikservo identify`. Wear shows as backlash or friction that rises by more than the uncertainty of
both measurements; heat, voltage and load are momentary values and only listed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, cast

from pydantic import Field

from ikservo.apps.lab.parameter_estimation import Identification
from ikservo.calibration.records import Name
from ikservo.errors import FileFormatError
from ikservo.files.reading import config_dir, read_text
from ikservo.files.validation import StrictModel
from ikservo.files.writing import exclusive_access, write_atomic
from ikservo.hardware.bus import ServoBus
from ikservo.registers import RegisterName

MAX_RECORDS = 2000
_MAX_BYTES = 8 * 1024 * 1024

Finite = Annotated[float, Field(ge=-1e6, le=1e6)]
Count = Annotated[int, Field(ge=0)]


class JointHealth(StrictModel):
    """Measurements of one servo; None for a quantity that was not measured."""

    name: Name = Field(description="the joint")
    id: Annotated[int, Field(ge=0, le=253)] = Field(description="the servo's id")
    temperature_c: Finite | None = Field(default=None, description="°C, the hottest reading")
    voltage_v: Finite | None = Field(default=None, description="V, the lowest reading")
    load: Finite | None = Field(default=None, description="the largest fraction of the full load")
    requests: Count = Field(default=0, description="the number of requests to the servo")
    lost: Count = Field(default=0, description="the number of requests without a usable reply")
    backlash_rad: Finite | None = Field(default=None, description="rad")
    backlash_error_rad: Finite | None = Field(default=None, description="its standard error")
    friction_nm: Finite | None = Field(default=None, description="N m, from rest")
    friction_error_nm: Finite | None = Field(default=None, description="its standard error")


class HealthRecord(StrictModel):
    """A line in the health file."""

    format: Literal[1] = Field(default=1, description="1")
    written: datetime = Field(strict=False, description="a date and time with UTC offset")
    source: Literal["monitor", "identify"] = Field(description="monitor or identify")
    joints: tuple[JointHealth, ...] = Field(strict=False, description="a list of objects")


def health_path(arm: str, usb_serial_number: str) -> Path:
    """Return the file of an arm on an adapter."""
    name = re.sub(r"[^A-Za-z0-9_-]", "_", f"{arm}-{usb_serial_number}")
    return config_dir() / "health" / f"{name}.jsonl"


def read_records(path: Path) -> list[HealthRecord]:
    """Read the records of an arm, the oldest first; empty if there is no file.

    Raises:
        FileFormatError: The file is damaged, or too large.
    """
    if not path.exists():
        return []
    records: list[HealthRecord] = []
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), 1):
        try:
            fields: object = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise FileFormatError(path, f"line {number}", "is not JSON") from error
        if not isinstance(fields, dict):
            raise FileFormatError(path, f"line {number}", "is not a record", "a JSON object")
        records.append(HealthRecord.from_tables(cast("object", fields), path))
    return records


def append_record(path: Path, record: HealthRecord) -> None:
    """Add a record to the file of an arm; above ``MAX_RECORDS``, drop the oldest.

    Raises:
        FileFormatError: The file is damaged; it is unchanged.
        FileWriteError: The file cannot be written; it is unchanged.
    """
    with exclusive_access(path):
        records = [*read_records(path), record][-MAX_RECORDS:]
        lines = (each.model_dump_json(exclude_none=True) for each in records)
        write_atomic(path, "".join(f"{line}\n" for line in lines))


_PERIOD_S = 0.1
_READ: tuple[RegisterName, ...] = (
    RegisterName.PRESENT_TEMPERATURE,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_LOAD,
)


def measure_health(bus: ServoBus, duration_s: float) -> tuple[JointHealth, ...]:
    """Read the servos of an arm for a while; nothing moves and torque does not change.

    Raises:
        PortLostError: The port is lost.
    """
    ends_s = bus.clock.now_s() + duration_s
    found: dict[int, list[Mapping[RegisterName, float]]] = {servo_id: [] for servo_id in bus.servos}
    while True:
        for servo_id, values in bus.sync_read_many(bus.servos, _READ).values.items():
            found[servo_id].append(values)
        next_s = bus.clock.now_s() + _PERIOD_S
        if next_s > ends_s:
            break
        bus.clock.sleep_until(next_s)
    joints: list[JointHealth] = []
    for servo_id, rows in found.items():
        temperatures, voltages, loads = ([row[name] for row in rows] for name in _READ)
        counts = bus.statistics[servo_id]
        joint = JointHealth(
            name=bus.servos[servo_id].name,
            id=servo_id,
            temperature_c=float(max(temperatures)) if rows else None,
            voltage_v=float(min(voltages)) if rows else None,
            load=float(max(map(abs, loads))) if rows else None,
            requests=counts.requests,
            lost=counts.lost + counts.garbled,
        )
        joints.append(joint)
    return tuple(joints)


def identified_health(bus: ServoBus, found: Identification) -> tuple[JointHealth, ...]:
    """Return the backlash and friction of each joint that an identification has determined."""
    ids = {servo.name: servo.id for servo in bus.servos.values()}
    rows: list[JointHealth] = []
    for name in found.joints:
        row = JointHealth(name=name, id=ids[name])
        play = found.estimates.get(f"{name}.backlash_rad")
        if play is not None and play.determined:
            row = row.model_copy(
                update={"backlash_rad": play.value, "backlash_error_rad": play.error}
            )
        parts = [found.estimates.get(f"{name}.{key}") for key in ("coulomb_nm", "slow_nm")]
        known = [each for each in parts if each is not None]
        if any(each.determined for each in known):
            friction_nm, error_nm = sum(x.value for x in known), min(x.error for x in known)
            row = row.model_copy(update={"friction_nm": friction_nm, "friction_error_nm": error_nm})
        rows.append(row)
    return tuple(rows)


def latest_health(records: Sequence[HealthRecord]) -> list[JointHealth]:
    """Return the latest known value of each quantity of each joint."""
    latest: dict[str, JointHealth] = {}
    for record in records:
        for joint in record.joints:
            before = latest.get(joint.name)
            kept = {} if before is None else before.model_dump(exclude_defaults=True)
            merged = {**kept, **joint.model_dump(exclude_defaults=True)}
            latest[joint.name] = JointHealth.model_validate(merged)
    return list(latest.values())


@dataclass(frozen=True, slots=True)
class Change:
    """An increase in the backlash or friction of a joint.

    Attributes:
        joint: The joint.
        key: ``backlash_rad`` or ``friction_nm``.
        before: The mean of the earlier measurements.
        now: The latest measurement.
        since: The time of the first earlier measurement.
        sigmas: The rise, in multiples of its standard error.
    """

    joint: str
    key: str
    before: float
    now: float
    since: datetime
    sigmas: float


# Repeated measurements differ by this much although nothing has changed, because posture, grease
# temperature and supply vary; the error of a single motion does not include this.
_REPEATS: Mapping[str, tuple[float, float]] = {  # smallest difference, and fraction of the value
    "backlash_rad": (math.radians(0.05), 0.02),
    "friction_nm": (0.01, 0.10),
}
_SIGMAS = 3.0  # one false alarm in 740 per joint and quantity, so 2 % for six joints


def changes_of(records: Sequence[HealthRecord]) -> list[Change]:
    """Return significant rises from the earlier measurements to the latest.

    Each joint's backlash and friction are compared with the weighted mean of earlier values. A rise
    counts if it exceeds three standard errors; for six joints, one report in fifty is then wrong.
    """
    names = dict.fromkeys(joint.name for record in records for joint in record.joints)
    changes = (_change(records, name, key) for name in names for key in _REPEATS)
    return [change for change in changes if change is not None]


def _change(records: Sequence[HealthRecord], name: str, key: str) -> Change | None:
    stem, _, unit = key.rpartition("_")
    floor, share = _REPEATS[key]
    rows: list[tuple[datetime, float, float]] = []
    for record in records:
        for joint in record.joints:
            value: float | None = getattr(joint, key)
            if joint.name == name and value is not None:
                own: float | None = getattr(joint, f"{stem}_error_{unit}")
                error = math.hypot(own or 0.0, floor, share * value)
                rows.append((record.written, value, error))
    if len(rows) < 2:
        return None
    *earlier, (_, now, error) = rows
    weights = [1.0 / each[2] ** 2 for each in earlier]
    before = sum(w * each[1] for w, each in zip(weights, earlier, strict=True)) / sum(weights)
    sigmas = (now - before) / math.hypot(error, 1.0 / math.sqrt(sum(weights)))
    return Change(name, key, before, now, earlier[0][0], sigmas) if sigmas > _SIGMAS else None

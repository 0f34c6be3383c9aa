"""The page of the servos' registers, from the control tables."""

from __future__ import annotations

from ikservo.registers.control_table import ControlTable
from ikservo.registers.models import MODELS
from ikservo.registers.register import Register
from pages.markdown import code, table

__all__ = ["registers_page"]

_INTRODUCTION = """# Registers of the servos

This page is generated from the control tables in `ikservo/registers`. *Raw* numbers are those of
the datasheet; one count equals the *step*. Addresses are decimal. EEPROM keeps its contents without
power and wears out when it is written; ikservo never writes it in order to move. A Feetech servo
stores EEPROM only while its register `lock` is 0.
"""


def registers_page() -> str:
    """Return the page as Markdown: one section for each servo model."""
    return "\n\n".join([_INTRODUCTION, *map(_section, MODELS.values())]) + "\n"


def _section(model: type[ControlTable]) -> str:
    rates = ", ".join(f"{rate:,}" for rate in model.baud_rates.values())
    facts = [
        ("model number", model.number),
        ("family in arm.toml", code(model.family.value)),
        ("counts in one turn", f"{model.ticks_per_turn:g}"),
        ("baud rates", rates),
    ]
    alarms = [(bit, alarm.value) for bit, alarm in model.alarm_bits.items()]
    return "\n\n".join(
        [
            f"## {model.model_name}",
            table(["fact", "value"], facts),
            table(["alarm bit", "meaning"], alarms),
            table(
                ["address", "bytes", "register", "access", "memory", "raw range", "step"],
                [_row(register) for register in model.registers.values()],
            ),
        ]
    )


def _row(register: Register) -> tuple[object, ...]:
    lowest, highest = register.range
    unit = register.unit
    step = "" if unit.step is None else f"{unit.step:.6g} {unit.symbol}".removesuffix(" 1")
    return (
        register.address,
        register.size,
        code(register.name),
        register.access.value,
        register.area.value,
        f"{lowest} to {highest}",
        step,
    )

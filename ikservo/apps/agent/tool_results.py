"""The results of the tools, with units in the field names. Untrusted texts are quoted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel

Point = tuple[float, float, float]


class ArmSummary(BaseModel):
    """An arm that this server controls, or that ikservo knows."""

    name: str
    title: str
    is_connected: bool


class ArmStatus(BaseModel):
    """The arm as measured now; joints in rad, prismatic joints in m."""

    tip_m: Point
    positions: Mapping[str, float]
    is_holding: bool
    stopped_for: str
    held_things: tuple[str, ...]
    consent: str
    budget: Mapping[str, float]


class Reach(BaseModel):
    """Whether the tip reaches a point inside the joint limits; obstacles are not considered."""

    is_reachable: bool
    nearest_m: Point
    error_m: float
    at_limits: tuple[str, ...]


class OfferedMotion(BaseModel):
    """A plan that can be executed once within five minutes."""

    plan_id: str
    summary: tuple[str, ...]
    duration_s: float | None
    tip_at_end_m: Point | None
    needs_consent: bool


class Execution(BaseModel):
    """The result of ``execute``."""

    status: Literal["done", "waiting_for_consent"]
    message: str
    results: tuple[Mapping[str, Any], ...] = ()


class SceneThing(BaseModel):
    """A thing around the arm; lengths in m, angles in degrees."""

    name: str
    kind: str
    sizes: Mapping[str, Any]
    is_own: bool


class SeenThing(BaseModel):
    """The first point that a pixel of the camera sees."""

    point_m: Point
    thing: str | None


class StepReport(BaseModel):
    """A step of a program."""

    number: int
    step: str
    error: str


class CheckedProgram(BaseModel):
    """A checked program; it has a plan if every step is possible."""

    steps: tuple[StepReport, ...]
    plan: OfferedMotion | None


class Refusal(BaseModel):
    """An earlier error of a tool."""

    tool: str
    kind: str
    message: str
    hint: str
    details: Mapping[str, Any]

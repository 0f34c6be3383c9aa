"""A visitor: what it may, and from where it looks at the arm."""

from __future__ import annotations

from dataclasses import dataclass, field

from ikservo.view.camera.camera import Viewport
from ikservo.view.camera.views import View
from ikservo.view.server.visitors import Right

__all__ = ["Visitor"]


@dataclass(slots=True)
class Visitor:
    """One page that is open.

    Attributes:
        number: Which.
        right: What its key lets it do.
        view: From where it looks.
        viewport: What it draws on; None until it has said so.
        told: What it was last told of each kind, so that nothing is told twice.
        told_s: When it was last told a scene and a status.
    """

    number: int
    right: Right
    view: View
    viewport: Viewport | None = None
    told: dict[str, object] = field(default_factory=dict[str, object])
    told_s: dict[str, float] = field(default_factory=dict[str, float])

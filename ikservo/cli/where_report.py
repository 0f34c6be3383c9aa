"""Print what is visible of the arm from a point, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ikservo.cli.terminal import format_point, print_lines, print_table
from ikservo.model import Model
from ikservo.view.visibility import LinkVisibility, visible_from

__all__ = ["VisibilityReport"]


@dataclass(frozen=True, slots=True)
class VisibilityReport:
    """How much of each link is seen from a point, and what hides the rest."""

    eye_m: tuple[float, float, float]
    links: tuple[LinkVisibility, ...]

    @classmethod
    def from_point(
        cls, model: Model, joints: Mapping[str, float], eye_m: tuple[float, float, float]
    ) -> VisibilityReport:
        """Look at an arm with its joints at positions (rad or m) from a point."""
        return cls(eye_m, visible_from(model, joints, eye_m))

    def print_table(self) -> None:
        """Print a table."""
        print_lines(["", f"seen from {format_point(self.eye_m)}"])
        print_table(
            ["link", "visible", "hidden by"], [_visibility_row(each) for each in self.links]
        )

    def fields(self) -> dict[str, object]:
        """Return the same for JSON."""
        links = [
            {"link": each.link, "visible_share": round(each.share, 3), "hidden_by": each.hidden_by}
            for each in self.links
        ]
        return {"eye_m": self.eye_m, "links": links}


def _visibility_row(seen: LinkVisibility) -> list[str]:
    share = f"{seen.share:.0%}" if seen.is_visible else "hidden"
    return [seen.link, share, ", ".join(seen.hidden_by)]

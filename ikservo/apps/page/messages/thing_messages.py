"""Messages of a page about the things around an arm."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ikservo.apps.page.messages.message_fields import PageMessage

ThingName = Annotated[str, Field(min_length=1, max_length=40)]
Number = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
Triple = Annotated[tuple[Number | None, Number | None, Number | None], Field(strict=False)]
"""Three numbers; None leaves a value unchanged."""


class AddThing(PageMessage):
    """Add a thing near the arm; from then on, the arm avoids it."""

    kind: Literal["add_thing"]
    shape: Literal["box", "cylinder", "sphere"]


class AddArm(PageMessage):
    """Make this arm and another arm of the page obstacles to each other."""

    kind: Literal["add_other_arm"]
    name: ThingName


class ChangeThing(PageMessage):
    """Change the given fields of a thing around the arm; the keys are as in a scene file."""

    kind: Literal["change_thing"]
    name: ThingName
    new_name: ThingName | None = None
    center_m: Triple | None = None
    size_m: Triple | None = None
    radius_m: Number | None = None
    height_m: Number | None = None
    rpy_deg: Triple | None = None
    at_m: Triple | None = None


class RemoveThing(PageMessage):
    """Remove a thing around the arm."""

    kind: Literal["remove_thing"]
    name: ThingName


class SaveThings(PageMessage):
    """Offer the things around the arm as a scene file."""

    kind: Literal["save_things"]


ThingMessage = AddThing | AddArm | ChangeThing | RemoveThing

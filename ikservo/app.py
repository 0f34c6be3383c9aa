"""Declaration of the commands, names and motions that an app adds to ikservo.

An app is a folder with commands, their modules, and one `App` value. The core finds this value and
imports the rest on first use; no module of the core imports an app. Built-in apps are the folders
of ``ikservo.apps``; other distributions list their apps in the entry point group ``ikservo.apps``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Command:
    """Declaration of a command, which ``--help`` lists without importing its module.

    Attributes:
        module: Module that defines ``command``, or the place ``package.module:name`` of another
            function; empty for a group, whose commands are named "group command".
        help: One line for the list of commands.
        panel: Heading under which the command is listed.
    """

    module: str
    help: str
    panel: str


@dataclass(frozen=True, slots=True)
class Panel:
    """Content of a panel of the page.

    Attributes:
        rows: Names and values, as text.
        motions: Motions by the text on their buttons; they are built like the steps of a program.
    """

    rows: Sequence[tuple[str, str]] = ()
    motions: Mapping[str, Any] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True, slots=True, kw_only=True)
class App:
    """Parts that an app adds to ikservo; a place is ``package.module:name``, imported on first use.

    Attributes:
        name: Name of the app, of its folder, of its page in the documents, and of its extra.
        commands: The commands by name; "arms new" is ``new`` in the group ``arms``.
        names: Names that are added to the package ``ikservo``, each with its place.
        arm_methods: Methods of an open arm, each with the place of a function of the arm.
        arm_values: Attributes of an open arm, each with the place of a function of the arm.
        motions: Kinds of motions, each with the place of its class; programs use them as steps.
        networks: Address schemes, each with the place of an ``ArmNetwork``.
        panels: Panels of the page, each heading with the place of a function that returns a `Panel`
            for the model of the arm and its measured positions (rad or m by joint).
        parts: Objects that commands of other apps look up by name, with the place of each object.
    """

    name: str
    commands: Mapping[str, Command] = field(default_factory=lambda: _NONE)
    names: Mapping[str, str] = field(default_factory=lambda: _NONE)
    arm_methods: Mapping[str, str] = field(default_factory=lambda: _NONE)
    arm_values: Mapping[str, str] = field(default_factory=lambda: _NONE)
    motions: Mapping[str, str] = field(default_factory=lambda: _NONE)
    networks: Mapping[str, str] = field(default_factory=lambda: _NONE)
    panels: Mapping[str, str] = field(default_factory=lambda: _NONE)
    parts: Mapping[str, str] = field(default_factory=lambda: _NONE)

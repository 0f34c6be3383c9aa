"""The value that says what an app adds to ikservo.

An app is a folder with commands and whatever they need, and one `App`. The core finds that value
and imports the rest when it is used; it never imports an app itself. Built-in apps are the folders
of ``ikservo.apps``; other distributions name theirs in the entry point group ``ikservo.apps``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Command:
    """A command, listed by ``--help`` before its module is imported.

    Attributes:
        module: The module that defines ``command``, or the place ``package.module:name`` of another
            function; empty for a group of the commands below it, whose names are "group command".
        help: One line for the list of commands.
        panel: The heading under which it is listed.
    """

    module: str
    help: str
    panel: str


@dataclass(frozen=True, slots=True)
class Panel:
    """What a panel of the page shows now.

    Attributes:
        rows: Names and values, as text.
        motions: Motions by the text of their buttons, made as a step of a program is.
    """

    rows: Sequence[tuple[str, str]] = ()
    motions: Mapping[str, Any] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True, slots=True, kw_only=True)
class App:
    """What an app adds to ikservo. Places are ``package.module:name``, imported when they are used.

    Attributes:
        name: Its name; that of its folder, its page in the documents, and its extra.
        commands: Its commands by name; "arms new" is ``new`` below ``arms``.
        names: Names of the package ``ikservo``, by place.
        arm_methods: Methods of an open arm, by the place of a function that takes the arm first.
        arm_values: Attributes of an open arm, by the place of a function that makes one of it.
        motions: Kinds of motions, by the place of the class: steps of programs, too.
        networks: Schemes of addresses, by the place of an ``ArmNetwork``.
        panels: Panels of the page by heading, by the place of a function that returns a `Panel`
            for the model of the arm and its measured positions (rad or m by joint).
        parts: Objects that commands of other apps look up by a name such as ``calibrate --camera``.
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

"""Find the apps in ikservo and in other distributions, and the parts that they offer."""

from __future__ import annotations

import contextlib
import io
import pkgutil
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from ikservo.app import App, Command
from ikservo.core_commands import CORE
from ikservo.errors import InputError

APP_GROUP = "ikservo.apps"
"""Entry point group: each entry is the `App` of another distribution."""

_COMMAND_NAME = re.compile(r"[a-z][a-z0-9-]*( [a-z][a-z0-9-]*)?")


@cache
def built_in_apps() -> tuple[App, ...]:
    """Return the core, then the apps in ``ikservo.apps`` by name, without reading entry points."""
    try:
        folder = import_module("ikservo.apps")
    except ModuleNotFoundError:  # all built-in apps were deleted
        return (CORE,)
    names = sorted(each.name for each in pkgutil.iter_modules(folder.__path__) if each.ispkg)
    apps = (cast("App", import_module(f"ikservo.apps.{name}").APP) for name in names)
    return (CORE, *apps)


@cache
def installed_apps() -> tuple[tuple[App, ...], tuple[str, ...]]:
    """Return the apps from other distributions, and a message for each app that cannot be used.

    An app that fails or prints while it is imported, or that uses a name from another app, is left
    out and does not affect the others.
    """
    if not other_packages_have(APP_GROUP):
        return (), ()
    from importlib.metadata import entry_points  # noqa: PLC0415  # slow, seldom needed

    found: list[App] = []
    problems: list[str] = []
    for point in sorted(entry_points(group=APP_GROUP), key=lambda each: each.name):
        source = f"The app {point.name!r} of {point.dist.name if point.dist else point.value}"
        printed = io.StringIO()
        try:
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                app: object = point.load()
        except (Exception, SystemExit) as error:  # an import can raise anything
            problems.append(f"{source} cannot be imported: {type(error).__name__}: {error}")
            continue
        problem = _find_problem(app, (*built_in_apps(), *found))
        if printed.getvalue():
            problem = problem or "prints while it is imported"
        if problem:
            problems.append(f"{source} cannot be used: it {problem}.")
        else:
            found.append(cast("App", app))
    return tuple(found), tuple(" ".join(each.split()) for each in problems)


def all_apps() -> tuple[App, ...]:
    """Return the built-in apps, then those from other distributions."""
    return (*built_in_apps(), *installed_apps()[0])


def load_place(place: str) -> Any:  # noqa: ANN401  # whatever an app offers
    """Import the module in ``package.module:name``, and return the object of that name."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


class ImportedMethod:
    """A method whose module is imported at its first use, to keep the opening of an arm fast.

    Args:
        place: ``package.module:name`` of a function whose first parameter is the object.
    """

    def __init__(self, place: str) -> None:
        self._place = place

    def __get__(self, owner: object, kind: type) -> Any:  # noqa: ANN401  # its own signature
        """Return the function, bound to the object if there is one."""
        function = load_place(self._place)
        return function if owner is None else function.__get__(owner, kind)


def offered_part(name: str) -> Any | None:  # noqa: ANN401  # whatever an app offers
    """Return the part that an app offers to other apps' commands; None if no app offers it."""
    for app in all_apps():
        if name in app.parts:
            return load_place(app.parts[name])
    return None


def find_part(name: str) -> Any:  # noqa: ANN401  # whatever an app offers
    """Return the part that an app offers to other apps' commands under a name.

    Raises:
        InputError: No installed app offers this part.
    """
    found = offered_part(name)
    if found is None:
        raise InputError(f"{name} needs an app that is not installed.", "Reinstall all of ikservo.")
    return found


def other_packages_have(group: str) -> bool:
    """Check whether another distribution has entry points of a group.

    ``importlib.metadata`` is not used, because importing it takes longer than braking an arm.
    """
    return f"[{group}]" in _entry_points_of_others()


@cache
def _entry_points_of_others() -> str:
    texts: list[str] = []
    for folder in filter(None, sys.path):
        for path in Path(folder).glob("*.dist-info/entry_points.txt"):
            if not path.parent.name.startswith("ikservo-"):
                with contextlib.suppress(OSError, ValueError):
                    texts.append(path.read_text("utf-8"))
    return "\n".join(texts)


def _find_problem(app: object, others: Sequence[App]) -> str:
    """Return the reason why an app cannot be used; empty if it can be used."""
    if not isinstance(app, App):
        return "is not an ikservo.app.App"
    try:
        return next(_problems(app, others), "")
    except (AttributeError, TypeError, ValueError) as error:
        return f"has a field of the wrong type ({error})"


def _problems(app: App, others: Sequence[App]) -> Iterator[str]:
    for name, command in app.commands.items():
        if not isinstance(cast("object", command), Command) or not _COMMAND_NAME.fullmatch(name):
            yield f"has a command {name!r} that is not a Command with a plain name"
        if any(name in other.commands for other in others):
            yield f"has a command {name!r}, which exists already"
    for what in ("names", "arm_methods", "arm_values", "motions", "networks", "panels", "parts"):
        places: Mapping[str, str] = getattr(app, what)
        for name, place in places.items():
            if not re.fullmatch(r"[\w.]+:\w+", place):
                yield f"has {place!r} in {what}, which is not a package.module:name"
            if any(name in getattr(other, what) for other in others):
                yield f"has {name!r} in {what}, which exists already"


def member_of_arms(arm: object, name: str) -> Any:  # noqa: ANN401  # whatever an app offers
    """Return a method or an attribute that an app adds to every open arm.

    Raises:
        AttributeError: No app adds this name.
    """
    for app in all_apps():
        if name in app.arm_values:
            value = load_place(app.arm_values[name])(arm)
            vars(arm)[name] = value  # later look-ups do not come here
            return value
        if name in app.arm_methods:
            return load_place(app.arm_methods[name]).__get__(arm)
    kind = type(arm).__name__
    raise AttributeError(f"{kind!r} object has no attribute {name!r}", name=name, obj=arm)


def member_names() -> list[str]:
    """Return the names of all methods and attributes that apps add to open arms."""
    return [name for app in all_apps() for name in (*app.arm_methods, *app.arm_values)]

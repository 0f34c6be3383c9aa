"""Checks of every command's arguments: a bare arm name, and only finite numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from collections.abc import Iterable

_LARGEST_NUMBER = 1e9  # products of numbers up to this size are still finite
_FREE_WORDS = ("FILE", "LEADER", "NAME")  # metavars of arguments that may equal an arm's name


def names_arm(word: str) -> bool:
    """Check whether a word on the command line can only refer to an arm, by name or file."""
    if word.endswith("arm.toml") or (Path(word) / "arm.toml").is_file():
        return True
    if not word.isidentifier():  # such as a port, a file, a coordinate
        return False
    from ikservo.model import arm_names  # noqa: PLC0415  # loads NumPy

    return word in arm_names()


class CheckedCommand(TyperCommand):
    """Command that accepts a bare arm name for ``--arm``, and refuses infinite or huge numbers."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Parse arguments and check their numbers."""
        argument, arm = None, ""
        if any("--arm" in each.opts for each in self.params):
            args = self._with_arm_as_option(ctx, args)
        else:
            named = (each for each in self._arguments() if "ARM" in str(each.metavar))
            argument = next(named, None)
            arm, args = _split_arm_option(args) if argument is not None else ("", args)
        rest = super().parse_args(ctx, args)
        if argument is not None and arm:
            source = ctx.get_parameter_source(argument.name)
            if source is not None and source.name == "COMMANDLINE" and argument.nargs == 1:
                ctx.fail(f"The arm is given twice: {ctx.params[argument.name]} and --arm {arm}.")
            others = ctx.params[argument.name] or ()
            ctx.params[argument.name] = arm if argument.nargs == 1 else [arm, *others]
        for parameter in self.params:
            _check_numbers(ctx, parameter, ctx.params.get(parameter.name))
        return rest

    def _arguments(self) -> list[Any]:
        return [each for each in self.params if each.param_type_name == "argument"]

    def _with_arm_as_option(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Return arguments with a bare arm name turned into the option ``--arm NAME``."""
        arguments = self._arguments()
        takes_arms = bool(arguments) and "ARM" in str(arguments[0].metavar)
        if takes_arms or _split_arm_option(args)[0] or "--help" in args:
            return args
        values, rest, _ = self.make_parser(ctx).parse_args(args=list(args))
        given: list[Any] = [values.get(each.name) for each in arguments]
        words: list[str] = [each for each in given if isinstance(each, str)]
        for each in (*given, rest):
            words += each if isinstance(each, list | tuple) else ()
        if not words or not names_arm(words[0]):
            return args
        needed = sum(each.required for each in arguments)
        if len(words) <= needed and arguments[0].metavar in _FREE_WORDS:
            return args  # a file or a pose may have the name of an arm
        place = args.index(words[0])
        return [*args[:place], *args[place + 1 :], "--arm", words[0]]


def _check_numbers(ctx: Any, parameter: Any, value: object) -> None:  # noqa: ANN401
    """Refuse numbers that are not finite or whose products overflow."""
    if isinstance(value, list | tuple):
        for each in cast("Iterable[object]", value):
            _check_numbers(ctx, parameter, each)
    elif isinstance(value, float | int) and not abs(value) <= _LARGEST_NUMBER:
        raise typer.BadParameter(
            f"{value:g} is not a number within ±{_LARGEST_NUMBER:g}.", ctx=ctx, param=parameter
        )


def _split_arm_option(args: list[str]) -> tuple[str, list[str]]:
    """Return the value of ``--arm`` (empty if it is missing) and the other arguments."""
    for place, arg in enumerate(args):
        if arg.startswith("--arm="):
            return arg.partition("=")[2], [*args[:place], *args[place + 1 :]]
        if arg == "--arm" and place + 1 < len(args):
            return args[place + 1], [*args[:place], *args[place + 2 :]]
    return "", args

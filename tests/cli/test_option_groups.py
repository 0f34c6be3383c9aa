"""Groups of options: a command takes a dataclass, its user sees single options."""

import inspect
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer

from ikservo.cli.option_groups import Without, with_options_of_groups


@dataclass(frozen=True, kw_only=True)
class Paint:
    """Options of a painting."""

    colour: Annotated[str, typer.Option("--colour", help="A colour.")] = "red"
    coats: Annotated[int, typer.Option("--coats", help="How many.")] = 1


@dataclass(frozen=True, kw_only=True)
class OilPaint(Paint):
    """The same options with another help text."""

    colour: Annotated[str, typer.Option("--colour", help="A colour of oil.")] = "blue"


def names(command):
    return list(inspect.signature(with_options_of_groups(command)).parameters)


def test_cli_option_group_is_expanded_in_place():
    def command(what: str, *, paint: Paint, dry: bool = False): ...

    assert names(command) == ["what", "colour", "coats", "dry"]


def test_cli_option_group_values_are_passed_as_one_object():
    got = []

    def command(what: str, *, paint: Annotated[OilPaint, Without("coats")]):
        got.append((what, paint))

    with_options_of_groups(command)(what="wall", colour="green")
    assert got == [("wall", OilPaint(colour="green", coats=1))]


def test_cli_option_excluded_from_group_is_not_available():
    def command(*, paint: Annotated[OilPaint, Without("coats")]): ...

    assert names(command) == ["colour"]


def test_derived_cli_option_group_replaces_option_in_place():
    def command(*, paint: OilPaint): ...

    options = inspect.signature(with_options_of_groups(command)).parameters
    assert [options["colour"].default, *options] == ["blue", "colour", "coats"]
    assert options["colour"].annotation.__metadata__[0].help == "A colour of oil."


def test_cli_option_group_with_misspelt_exclusion_is_refused():
    def command(*, paint: Annotated[Paint, Without("color")]): ...

    with pytest.raises(TypeError, match="Paint has no color"):
        with_options_of_groups(command)

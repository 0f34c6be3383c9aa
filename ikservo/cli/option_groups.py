"""Groups of options: a dataclass whose fields are options, passed to a command as one parameter."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints


class Without:
    """Names of a group's options that a command does not offer; these keep their defaults.

    ``Annotated[MotionOptions, Without("tip")]`` is the type of the command's parameter.
    """

    def __init__(self, *names: str) -> None:
        self.names = frozenset(names)


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for typer, with a parameter for each option of its groups.

    The options replace their group in the list of parameters, so the help lists them in order.

    Raises:
        TypeError: ``Without`` names an option that the group does not have.
    """
    groups: dict[str, tuple[type, list[str]]] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        marked = get_origin(parameter.annotation) is Annotated
        group = get_args(parameter.annotation)[0] if marked else parameter.annotation
        if isinstance(group, type) and is_dataclass(group):
            options = list(_options(group, parameter.annotation))
            groups[parameter.name] = (group, [option.name for option in options])
            parameters += options
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    def run(**given: Any) -> None:  # noqa: ANN401  # values of options
        made = {
            name: group(**{option: given.pop(option) for option in options})
            for name, (group, options) in groups.items()
        }
        command(**given, **made)

    run.__doc__ = command.__doc__
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    run.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    return run


def _options(group: Any, annotation: Any) -> Iterator[inspect.Parameter]:  # noqa: ANN401
    """Yield the options of a group that its command offers, as parameters."""
    marks = (each for each in get_args(annotation)[1:] if isinstance(each, Without))
    omitted = next(marks, Without()).names
    types = get_type_hints(group, include_extras=True)
    if not omitted <= types.keys():
        raise TypeError(f"{group.__name__} has no {', '.join(sorted(omitted - types.keys()))}.")
    for field in fields(group):
        if field.name not in omitted:
            yield inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=types[field.name],
            )

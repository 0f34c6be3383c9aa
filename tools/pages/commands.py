"""The page of the commands, from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ikservo.cli.command_group import built_in_commands, load_command
from ikservo.core_commands import PANELS
from ikservo.errors import ExitCode
from pages.markdown import code, table

__all__ = ["commands_page"]

_INTRODUCTION = """# Commands

This page is generated from the commands. `ikservo COMMAND --help` prints the same in a terminal.

Lengths are in metres (`120mm` and `12cm` work), angles in degrees (`0.2rad` works). Data is printed
on stdout, all other text on stderr. `--json` prints one object per line: [JSON output](../json.md).
Exit codes are explained in [Troubleshooting](../troubleshooting.md#exit-codes).
"""


def commands_page() -> str:
    """Return the page as Markdown: one section for each command, in the order of the help."""
    parts = [_INTRODUCTION, _exit_codes()]
    for panel in PANELS:
        parts.append(f"## {panel}")
        listed = [item for item in built_in_commands().items() if item[1].panel == panel]
        parts += [_section(load_command(*item)) for item in listed if item[1].module]
    return "\n\n".join(parts) + "\n"


def _exit_codes() -> str:
    rows = [(exit_code.value, exit_code.meaning) for exit_code in ExitCode]
    return table(["exit code", "meaning"], rows)


def _section(command: Any) -> str:  # noqa: ANN401  # typer hides click's types
    summary, examples = _split_help(command)
    context = command.make_context(command.name, [], resilient_parsing=True)
    usage = " ".join(["ikservo", command.name, *command.collect_usage_pieces(context)])
    parts = [f"### ikservo {command.name}", summary, _block([usage])]
    if examples:
        parts += ["Examples:", _block(examples)]
    for kind in ("argument", "option"):
        params = [param for param in command.params if param.param_type_name == kind]
        records = [param.get_help_record(context) for param in params]
        rows = [(code(name), meaning) for name, meaning in filter(None, records)]
        parts += [table([kind, "meaning"], rows)] if rows else []
    return "\n\n".join(parts)


def _split_help(command: Any) -> tuple[str, list[str]]:  # noqa: ANN401
    """Return the prose of the help, and its example lines."""
    paragraphs = [" ".join(text.split()) for text in (command.help or "").split("\n\n")]
    lines = [text.strip() for text in (command.help or "").splitlines()]
    examples = [line for line in lines if line.startswith("ikservo ")]
    prose = [text for text in paragraphs if text and not text.startswith("ikservo ")]
    return "\n\n".join(prose), examples


def _block(lines: Iterable[str]) -> str:
    return "\n".join(["```text", *lines, "```"])

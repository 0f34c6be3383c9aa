"""No numeric option or argument of any command takes a number that overflows."""

import typer

from ikservo.cli.command_group import app
from ikservo.errors import IkservoError

ClickException = typer.BadParameter.__mro__[2]  # typer has a copy of click, or uses it

HOSTILE = ("nan", "inf", "-inf", "1e308", "1e308m", "1e308mm", "1e308s")


def test_numeric_options_refuse_overflowing_numbers():
    root = typer.main.get_command(app)
    tried = 0
    for name in root.list_commands(None):
        command = root.get_command(None, name)
        for parameter in command.params:
            for text in HOSTILE if parameter.param_type_name == "option" else ():
                if parameter.is_flag or parameter.count:
                    continue
                try:
                    context = command.make_context(
                        name, [f"{parameter.opts[0]}={text}"], resilient_parsing=False
                    )
                except (ClickException, IkservoError):
                    continue
                value = context.params[parameter.name]
                for each in value if isinstance(value, list | tuple) else [value]:
                    assert not isinstance(each, float) or abs(each) < 1e9, (name, parameter.name)
                tried += 1
    assert tried > 20

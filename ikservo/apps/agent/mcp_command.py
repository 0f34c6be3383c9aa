"""``ikservo mcp``: serve an arm to an agent that speaks the Model Context Protocol."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.agent.agent_journal import AgentJournal, latest_journal, read_journal
from ikservo.apps.agent.allowance import Allowance, Consent
from ikservo.arm.opening import require_own_port
from ikservo.cli.completion import complete_from
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, NamedServoConnection, PathOptions
from ikservo.cli.terminal import print_lines, print_status
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import InputError
from ikservo.remedies import install_command

Allow = Annotated[
    Consent,
    typer.Option(
        "--allow",
        help="nothing: plan only; ask: a person allows each plan; simulator: every motion of a "
        "simulated arm; slow: slow motions in --keep-in, up to --budget.",
        autocompletion=complete_from(*Consent),
    ),
]
Motions = Annotated[
    int, typer.Option("--budget", min=1, max=10_000, help="Motions allowed by --allow slow.")
]
Minutes = Annotated[
    float, typer.Option("--minutes", min=0.1, max=1440, help="Minutes allowed by --allow slow.")
]
Approve = Annotated[
    bool, typer.Option("--approve", help="Allow the plans of a running server, in this terminal.")
]
Replay = Annotated[bool, typer.Option("--replay", help="Print the journal of the last agent.")]
JournalFile = Annotated[
    Path | None, typer.Option("--journal", help="Journal to print with --replay.")
]
HttpPort = Annotated[
    int | None,
    typer.Option(
        "--http-port",
        min=0,
        max=65535,
        help="Serve HTTPS on this TCP port, with a key, instead of standard input; 0: any.",
    ),
]
Listen = Annotated[
    str, typer.Option("--listen", help="IP address for --http-port; default: this machine only.")
]


def command(
    connection: NamedServoConnection,
    *,
    allow: Allow = Consent.NOTHING,
    budget: Motions = 20,
    minutes: Minutes = 30.0,
    approve: Approve = False,
    replay: Replay = False,
    journal: JournalFile = None,
    http_port: HttpPort = None,
    listen: Listen = "127.0.0.1",
    path: Annotated[PathOptions, Without("upright_rad", "keep_axis")],
    options: Annotated[MotionOptions, Without("dry_run", "json", "tip", "yes", "collision")],
) -> None:
    """Serve an arm to a language model, which plans motions; a person allows each motion.

    The model's program starts this command and speaks to it through standard input and output.

    ikservo mcp so101 --port sim --allow simulator

    ikservo mcp so101 --allow ask               then, in another terminal: ikservo mcp --approve

    ikservo mcp --replay                        prints what the last agent did
    """
    if replay:
        print_lines(read_journal(journal or latest_journal()))
        return
    if find_spec("mcp") is None:
        raise InputError("The mcp package is not installed.", f"Run: {install_command('agent')}")
    if approve:
        from ikservo.apps.agent.consent_terminal import answer_in_terminal  # noqa: PLC0415

        answer_in_terminal()
        return
    allowance = Allowance(allow, path.within(), budget, minutes)
    # Both import the protocol's server, which --approve and --replay do not need.
    from ikservo.apps.agent.agent_arm import AgentArm  # noqa: PLC0415
    from ikservo.apps.agent.transports import serve_agent  # noqa: PLC0415

    with exiting_on_signals(), open_from_options(connection, options, path.scene) as machine:
        arm = require_own_port(machine)
        if allow is not Consent.NOTHING:
            check_directions_once(arm, options)
        agent = AgentArm(arm, allowance, AgentJournal(arm.model.name))
        print_status(f"Journal: {agent.journal.path}")
        try:
            serve_agent(agent, http_port, listen)
        finally:
            agent.end()

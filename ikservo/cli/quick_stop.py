"""``ikservo stop`` without the modules of other commands: loading them takes longer than braking.

Nothing here imports typer, NumPy, pydantic or pyserial if a program of the user, or of another
machine, answers.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ikservo.app_discovery import offered_part, other_packages_have
from ikservo.cli.terminal import format_port, print_json, print_lines, print_status
from ikservo.errors import ExitCode, IkservoError, InputError
from ikservo.serving.control_client import (
    StopAllResult,
    request_stop,
    request_stop_of,
    stop_own_programs,
)

_VALUES, _FLAGS = ("--arm", "--port"), ("--all", "--json")
_ARM_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_MAX_ARM_FILE_BYTES = 1_000_000
_NETWORKS = "ikservo.networks"
"""The name of the entry point group; equals ``ikservo.hardware.transport.NETWORK_GROUP``."""


def quick_stop(args: Sequence[str]) -> int | None:
    """Stop the arms that programs of this user have open; ``args`` follow ``ikservo stop``.

    Returns:
        The exit code; None if the complete command is needed to stop the arm or explain an error:
        no program has the arm's port open, or an argument is unknown.

    Raises:
        IkservoError: That program cannot stop the arm, or no program has an arm open.
    """
    options = _read_options(args)
    if options is None:
        return None
    arm = options.get("--arm") or os.environ.get("IKSERVO_ARM", "")
    port = options.get("--port") or os.environ.get("IKSERVO_PORT", "")
    if "--all" in options or not (arm or port):
        return report_stop(stop_every_arm(), as_json="--json" in options)
    found = _stop_one(_name_of(arm), port)
    return report_stop(found, as_json="--json" in options) if found.stopped else None


def _stop_one(arm: str, port: str) -> StopAllResult:
    """Stop an arm by its name or port; the result is empty if that needs the complete command."""
    remote = offered_part("stop")
    if remote is not None and port.startswith(f"{remote.scheme}:"):
        return StopAllResult((remote.stop_address(port),))
    if not arm or ":" in port or port == "sim":
        return StopAllResult()
    if not port:
        return request_stop_of(arm)
    stopped = request_stop(port, arm)
    return StopAllResult() if stopped is None else StopAllResult((stopped,))


def _name_of(arm: str) -> str:
    """Return the name of an arm from its name or arm file; empty if it cannot be read."""
    if _ARM_NAME.fullmatch(arm):
        return arm
    path = Path(arm)
    if path.is_dir():
        path /= "arm.toml"
    try:
        is_file = path.suffix == ".toml" and path.is_file()  # reading a pipe would block
        if not is_file or path.stat().st_size > _MAX_ARM_FILE_BYTES:
            return ""
        name: object = tomllib.loads(path.read_text("utf-8")).get("name")
    except (OSError, ValueError, RecursionError):  # the complete command says what is wrong
        return ""
    return name if isinstance(name, str) and _ARM_NAME.fullmatch(name) else ""


def stop_every_arm() -> StopAllResult:
    """Stop every arm whose port a program of this user has open, and arms on other machines.

    Those are the arm at the address in ``IKSERVO_PORT`` and the arms on listed machines.

    Raises:
        InputError: No program has an arm open, and no arm is served on this machine.
    """
    with ThreadPoolExecutor(1) as pool:  # an arm without a reply must not delay the others
        own = pool.submit(stop_own_programs)
        # A machine is listed, or an arm is served here, perhaps by another user.
        remote = offered_part("stop")
        others_may_be_open = ":" in os.environ.get("IKSERVO_PORT", "") or (
            remote is not None and remote.may_find_arms()
        )
        found = [_stop_others()] if others_may_be_open else []
        found.insert(0, own.result())
    if not found[0].stopped and len(found) == 1:
        found.append(_stop_others())
    joined = StopAllResult.joined(found)
    if not (joined.stopped or joined.errors):
        raise InputError(
            "None of your programs has an arm open, and no arm is served on this machine.",
            "A program that is still starting will not move anything. To stop the servos of an arm "
            "directly: ikservo stop --arm NAME",
        )
    return joined


def report_stop(found: StopAllResult, *, as_json: bool) -> int:
    """Print which arms were stopped and which were not; return the exit code."""
    if as_json:
        errors = [
            {"error": e.command_message, "hint": e.command_hint, "exit_code": int(e.exit_code)}
            for e in found.errors
        ]
        print_json("stop", arms=found.stopped, errors=errors)
    else:
        for one in found.stopped:
            was = "was moving; stopped" if one.moving else "was not moving"
            if one.latched:
                was += "; acknowledge the stop in its program before it can move again"
            rows = {"torque on": one.held, "torque off": one.limp, "no answer": one.silent}
            servos = [f"{label:10}  {', '.join(names)}" for label, names in rows.items() if names]
            print_lines([f"{one.arm} on {format_port(one.port)} {was}", *servos], indent=12)
        for error in found.errors:
            print_status(f"Could not confirm the stop: {error.command_message}")
            print_status(error.command_hint)
    for error in found.errors:
        return error.exit_code
    return ExitCode.SILENT if any(one.silent for one in found.stopped) else ExitCode.DONE


def _read_options(args: Sequence[str]) -> Mapping[str, str] | None:
    """Read the options of a command line; None if only the complete command can read them."""
    options, rest = dict[str, str](), list(args)
    while rest:
        name, equals, value = rest.pop(0).partition("=")
        if name in _FLAGS and not equals:
            options[name] = ""
        elif name in _VALUES and (equals or rest):
            options[name] = value if equals else rest.pop(0)
        else:
            return None
    return options


def _stop_others() -> StopAllResult:
    own, remote = os.environ.get("IKSERVO_PORT", ""), offered_part("stop")
    is_own = remote is not None and own.startswith(f"{remote.scheme}:")
    if other_packages_have(_NETWORKS) or (":" in own and not is_own):
        from ikservo.arm.other_process import stop_remote_arms  # noqa: PLC0415  # NumPy, pydantic

        return stop_remote_arms()
    if remote is None:
        return StopAllResult()

    def stop_own() -> StopAllResult:
        try:
            return StopAllResult((remote.stop_address(own),) if is_own else ())
        except IkservoError as error:
            return StopAllResult(errors=(error,))

    with ThreadPoolExecutor(1) as pool:  # an arm without a reply must not delay the others
        first = pool.submit(stop_own)
        others = remote.stop_listed_machines()
        return StopAllResult.joined((first.result(), others))

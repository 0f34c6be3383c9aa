"""Allow the plans of a running agent in a terminal."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request

from ikservo.apps.agent.consent_server import stored_address
from ikservo.cli.terminal import confirm, print_lines, print_status
from ikservo.errors import IkservoError, InputError, printable

_TIMEOUT_S = 5.0
_PERIOD_S = 0.5


def answer_in_terminal() -> None:
    """Ask the user to allow each plan of the running server, until the server ends.

    Raises:
        InputError: No server is running.
        IkservoError: The server has stopped.
    """
    page, _, key = stored_address().partition("#")
    print_status("Waiting for the agent's plans. Ctrl-C ends only this command.")
    was_stopped = ""
    while True:
        now = json.loads(_call(page, key, "plans"))
        if now["stopped_for"] and now["stopped_for"] != was_stopped:
            print_lines([f"The arm is stopped: {printable(now['stopped_for'])}"])
            if confirm("Let it move again?"):
                _call(page, key, "acknowledge", "POST")
        was_stopped = now["stopped_for"]
        for plan in now["plans"]:
            print_lines([f"The agent asks (plan {plan['id']}):", *map(printable, plan["summary"])])
            print_status(f"Picture of the plan: {page}#{key}")
            answer = "yes" if confirm("Allow it?") else "no"
            _call(page, key, f"plans/{plan['id']}/{answer}", "POST")
        time.sleep(_PERIOD_S)


def _call(page: str, key: str, path: str, method: str = "GET") -> bytes:
    request = urllib.request.Request(  # noqa: S310  # an address on this machine
        page + path, method=method, headers={"authorization": f"Bearer {key}"}
    )
    try:
        with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as response:  # noqa: S310
            return response.read()
    except urllib.error.HTTPError as error:
        text = error.read().decode("utf-8", "replace")
        if error.code == 409:  # a plan that has expired meanwhile
            print_status(printable(text))
            return b""
        raise InputError("The agent's server refused the key.", "Try again.") from None
    except OSError:
        raise IkservoError("The agent has disconnected.") from None

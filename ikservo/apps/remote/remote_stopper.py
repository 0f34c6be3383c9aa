"""Stop arms on other machines for ``ikservo stop``; large imports are deferred."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from ikservo.apps.remote.address import SCHEME, listens, parse_host

if TYPE_CHECKING:
    from ikservo.serving.control_client import StopAllResult, StopResult


class RemoteStopper:
    """Stopper of arms on other machines, whoever controls them; see `ikservo.cli.quick_stop`."""

    scheme = SCHEME

    def may_find_arms(self) -> bool:
        """Check whether a machine is listed or an arm is served here, perhaps by another user."""
        return bool(os.environ.get("IKSERVO_FLEET")) or listens(parse_host("127.0.0.1"))

    def stop_address(self, address: str) -> StopResult:
        """Stop the arm at an address; see `ikservo.apps.remote.remote_stop`."""
        from ikservo.apps.remote.remote_stop import stop_address  # noqa: PLC0415  # Zenoh

        return stop_address(address)

    def stop_listed_machines(self) -> StopAllResult:
        """Stop every arm on the listed machines; see `ikservo.apps.remote.remote_stop`."""
        from ikservo.apps.remote.remote_stop import stop_listed_machines  # noqa: PLC0415  # Zenoh

        return stop_listed_machines()


REMOTE_STOPPER = RemoteStopper()

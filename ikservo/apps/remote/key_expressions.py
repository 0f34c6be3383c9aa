"""The key expressions of a served arm, each of which contains the arm's name.

=============================  ==============================================================
``ikservo/NAME/watch/SERVICE``   requests that move nothing, allowed to watchers
``ikservo/NAME/stop``            a stop, allowed to watchers
``ikservo/NAME/drive/SERVICE``   requests from the operator
``ikservo/NAME/setpoint``        heartbeats and goals from the operator
``ikservo/NAME/operator/TOKEN``  liveliness token of the operator
``ikservo/NAME/server``          liveliness token of the server of the arm
``ikservo/NAME/news/TOPIC``      states, progress, streams, published by the server
=============================  ==============================================================
"""

from __future__ import annotations

import hashlib

PREFIX = "ikservo"


def watch(name: str, service: str) -> str:
    """Return the key for a request that moves nothing."""
    return f"{PREFIX}/{name}/watch/{service}"


def drive(name: str, service: str) -> str:
    """Return the key for a request from the operator."""
    return f"{PREFIX}/{name}/drive/{service}"


def stop(name: str) -> str:
    """Return the key of a stop."""
    return f"{PREFIX}/{name}/stop"


def setpoint(name: str) -> str:
    """Return the key of the operator's setpoints."""
    return f"{PREFIX}/{name}/setpoint"


def operator(name: str, token: str) -> str:
    """Return the key of the operator's liveliness token; see ``operator_token``."""
    return f"{PREFIX}/{name}/operator/{token}"


def operator_token(lease: str) -> str:
    """Return the name of an operator's liveliness token, which others may read."""
    return hashlib.sha256(lease.encode()).hexdigest()[:24]


def server(name: str) -> str:
    """Return the key of the server's liveliness token."""
    return f"{PREFIX}/{name}/server"


def news(name: str, topic: str) -> str:
    """Return the key of the server's topics."""
    return f"{PREFIX}/{name}/news/{topic}"

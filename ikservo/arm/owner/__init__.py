"""One owner of a bus: the process that has the port listens, and other terminals ask it.

A request is one line of JSON, and so is its answer; see ``message``. Where the socket lies and who
may reach it stands in ``place``; the rest is a thread that listens and a client that asks.
"""

from ikservo.arm.owner.asking import ask, ask_all
from ikservo.arm.owner.listening import Listener, listen
from ikservo.arm.owner.message import Errand, Request

__all__ = ["Errand", "Listener", "Request", "ask", "ask_all", "listen"]

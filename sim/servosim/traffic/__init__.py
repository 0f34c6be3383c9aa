"""Who watches the line: a log of frames, an audit of what the host asked for."""

from servosim.traffic.audit import Audit
from servosim.traffic.journal import Journal
from servosim.traffic.witness import Witness

__all__ = ["Audit", "Journal", "Witness"]

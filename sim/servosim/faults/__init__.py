"""What goes wrong on a bus, by script and by seeded chance."""

from servosim.faults.fault import Fault, read_faults
from servosim.faults.script import FaultScript

__all__ = ["Fault", "FaultScript", "read_faults"]

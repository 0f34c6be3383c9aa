"""The gate before the bytes: what it lets pass is inside the limits and no jump."""

from ikservo.guard.fence import Fence
from ikservo.guard.gate import Gate

__all__ = ["Fence", "Gate"]

"""The gate before the bytes: what it lets pass is inside the limits, free of contact, no jump."""

from ikservo.guard.fence import Fence
from ikservo.guard.following import Following
from ikservo.guard.gate import Gate
from ikservo.guard.space import Box, Space

__all__ = ["Box", "Fence", "Following", "Gate", "Space"]

"""The desk a search works on: one array whose rows are everything that it writes down."""

from __future__ import annotations

__all__ = [
    "ACROSS",
    "ALONG",
    "BACK",
    "BEST",
    "CHORD2",
    "ENDS",
    "ERROR",
    "ERRORS",
    "FREE",
    "GAP2",
    "GAUGE",
    "HELD",
    "HIGH",
    "KEPT",
    "LOW",
    "NORMAL",
    "NOTED",
    "PROMISE",
    "PULL",
    "RHS",
    "SCORES",
    "STEP",
    "TOOL",
    "G",
    "H",
    "J",
    "Q",
    "Y",
    "desk_shape",
]

# fmt: off
# Rows with one entry a joint.
Q        = 0        # where the search stands
BACK     = 1        # where it stood before the step
STEP     = 2        # the step
PULL     = 3        # downhill: minus the gradient of half the squared error
FREE     = 4        # 1 for joints that the step may move, 0 for those on a limit
LOW      = 5        # the limits that this search respects
HIGH     = 6
HELD     = 7        # -1, 0 or 1: the limit that the descent pressed against
RHS      = 8        # right-hand side of a system in the joints
BEST     = 9        # where a slide has been best
KEPT     = 10       # where a walk was before it was nudged

# Short rows.
TOOL     = 11       # the tool's R row by row, then p (12)
ERROR    = 12       # the weighted error (3, 5 or 6)
Y        = 13       # right-hand side of a system in the error
GAUGE    = 14       # entries GAP2, CHORD2, NOTED

# Matrices.
J        = 15       # (6, n) Jacobian of the tool: linear rows, angular rows
G        = 21       # (6, n) Jacobian of the weighted error
NORMAL   = 27       # (6, 6) G Gᵀ
H        = 33       # (n, n) second derivative of half the squared error; column n its diagonal
ENDS     = 33       # (restarts, n) where quick attempts ended, n rows further down; after these the
                    # scores, see below

# Entries of GAUGE.
GAP2     = 0        # squared distance from the wanted position
CHORD2   = 1        # squared chord from the wanted orientation
NOTED    = 2        # rows of the trace that are filled

# Rows of the scores, with one entry a seed.
PROMISE  = 0        # the squared error that it promises
ALONG    = 1        # its part that goes with the cosine of the first joint's swing
ACROSS   = 2        # and that with the sine
ERRORS   = 3        # the squared error at the end of each attempt, the start's first
SCORES   = 4
# fmt: on


def desk_shape(n: int, restarts: int) -> tuple[int, int]:
    """Return the shape of the desk for n joints and some starting points."""
    width = max(n + 2, 12)
    return ENDS + n + restarts + -(-SCORES * restarts // width), width

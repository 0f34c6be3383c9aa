"""Where each number stands in the arrays that Python hands to the kernels."""

from __future__ import annotations

__all__ = [
    "ANSWER_TAIL",
    "BUDGET",
    "DIRECTION",
    "EXTRA_RESTARTS",
    "FURTHEST_M",
    "FURTHEST_RAD",
    "GAP",
    "ITERATIONS",
    "KIND",
    "NEAREST",
    "POSE",
    "POSITION_ONLY",
    "PRIORITY",
    "QUESTION_SIZE",
    "REACHED",
    "RESTARTS",
    "ROWS",
    "SEED",
    "SEED_COSINE",
    "SEED_FAR2",
    "SEED_POSITION",
    "SEED_ROTATION",
    "SEED_SINE",
    "SEED_SIZE",
    "SEED_SWING",
    "SETTINGS_SIZE",
    "TOLERANCE_CHORD",
    "TOLERANCE_M",
    "TRACED",
    "TRACK",
    "TURN",
    "TURN_WEIGHT",
    "WANTED_POSITION",
    "WANTED_ROTATION",
]

# Kinds of target, and how many rows their error has.
POSITION_ONLY, DIRECTION, POSE = 0, 1, 2
ROWS = (3, 5, 6)

FURTHEST_M = 1000.0
"""Beyond it squares of distances drown what a joint can do, and nobody has such an arm."""

FURTHEST_RAD = 1e6
"""A million radians still have a tenth of a nanoradian between two numbers."""

# fmt: off
# A question (QUESTION_SIZE,): the tool's pose that is wanted.
WANTED_POSITION  = 0        # (3,) metres
WANTED_ROTATION  = 3        # (9,) row by row; its last column is the wanted direction
QUESTION_SIZE    = 12

# Settings (SETTINGS_SIZE,): how the question is meant.
KIND             = 0        # POSITION_ONLY, DIRECTION, POSE
TOLERANCE_M      = 1
TOLERANCE_CHORD  = 2        # 2 sin(angle / 2)
TURN_WEIGHT      = 3        # metres of position error that one radian is worth
PRIORITY         = 4        # 1: the position first, the orientation as well as what remains allows
TRACK            = 5        # 1: one descent from the start, never past a limit, no full turns
RESTARTS         = 6        # how many starting points at most, the start included
EXTRA_RESTARTS   = 7        # how many more after the first success, to prefer what is nearest
BUDGET           = 8        # how many steps from one starting point
SETTINGS_SIZE    = 9

# A seed is a column (dof + SEED_SIZE,): its joints, then, as seen from the first joint's frame,
SEED_ROTATION    = 0        # (9,) the tool's R row by row
SEED_POSITION    = 9        # (3,) where the tool is, metres
SEED_FAR2        = 12       # the square of how far that is
SEED_SWING       = 13       # where the first joint stands for that,
SEED_COSINE      = 14       # and the cosine and sine of how far it may swing to either side
SEED_SINE        = 15
SEED_SIZE        = 16

# An answer (2 * dof + ANSWER_TAIL,): q, then -1, 0 or 1 a joint for the limit that binds, then
REACHED          = 0
GAP              = 1        # metres from the wanted position
TURN             = 2        # radians from the wanted direction or orientation
NEAREST          = 3        # (3,) where the point is
ITERATIONS       = 6
SEED             = 7        # which starting point led there, 0 for the start
TRACED           = 8        # how many rows of the trace are filled
ANSWER_TAIL      = 9
# fmt: on

"""Index constants of the kernel's work array, problem and result vectors."""

from __future__ import annotations

# fmt: off
# The work array: rows with one entry per joint.
Q                = 0        # the joints
Q_PREV           = 1        # the joints before the step
STEP             = 2        # the step
NEG_GRAD         = 3        # minus the gradient of half the squared residual
FREE             = 4        # 1 for joints that the step may move, 0 for those fixed at a limit
LOWER_LIMIT      = 5        # the limits that this attempt respects
UPPER_LIMIT      = 6
ACTIVE           = 7        # -1, 0 or 1: the limit that blocks the descent
RHS              = 8        # right-hand side of a system in the joints
Q_BEST           = 9        # the best joints of a descent in the null space
Q_SAVED          = 10       # the joints before a perturbation

# Short rows.
TOOL_POSE        = 11       # the tool's R row by row, then p (12)
RESIDUAL         = 12       # the weighted residual (3, 5 or 6)
RHS_ERROR        = 13       # right-hand side of a system in the residual
NORMS            = 14       # entries POS_ERR2, ROT_ERR2, TRACE_LEN

# Matrices.
J                = 15       # (6, n) Jacobian of the tool: linear rows, angular rows
J_WEIGHTED       = 21       # (6, n) Jacobian of the weighted residual, G
NORMAL           = 27       # (6, 6) G Gᵀ
HESSIAN          = 33       # (n, n) second derivative of half the squared residual; column n keeps
                            # its diagonal
END_POINTS       = 33       # (restarts, n) results of quick attempts; begins n rows further down

# Entries of NORMS.
POS_ERR2         = 0        # squared distance from the wanted position
ROT_ERR2         = 1        # squared chord from the wanted orientation
TRACE_LEN        = 2        # rows of the trace that are filled

# Rows of the scores (SCORE_ROWS, restarts), with one entry per seed.
SEED_COST        = 0        # expected squared error of the seed
SEED_COS         = 1        # the error's coefficient of the cosine of the first joint's turn
SEED_SIN         = 2        # the error's coefficient of the sine of this turn
END_COST         = 3        # squared error of each attempt's result; first the start's
SCORE_ROWS       = 4
# fmt: on


def work_shape(n: int, restarts: int) -> tuple[int, int]:
    """Compute the shape of the work array for n joints and a number of starting points."""
    return END_POINTS + n + restarts, max(n + 2, 12)


# Kinds of target, and the number of rows of their residuals.
POSITION_ONLY, DIRECTION, POSE = 0, 1, 2
ROWS = (3, 5, 6)

MAX_POSITION_M = 1000.0
"""Largest distance [m]; beyond it, squares of distances hide the effect of a joint."""

MAX_ANGLE_RAD = 1e6
"""Largest start [rad]; at a million radians numbers are still a tenth of a nanoradian apart."""

# fmt: off
# A problem (PROBLEM_SIZE,): the wanted pose of the tool.
WANTED_POSITION  = 0        # (3,) metres
WANTED_ROTATION  = 3        # (9,) row by row; its last column is the wanted direction
PROBLEM_SIZE     = 12

# Settings (SETTINGS_SIZE,).
KIND             = 0        # POSITION_ONLY, DIRECTION, POSE
TOLERANCE_M      = 1
TOLERANCE_CHORD  = 2        # 2 sin(angle / 2)
ROTATION_WEIGHT  = 3        # metres of position error that weigh like one radian
POSITION_FIRST   = 4        # 1: position first, orientation as well as possible
TRACK            = 5        # 1: one descent from the start, never past a limit, no full turns
RESTARTS         = 6        # largest number of starting points, including the start
EXTRA_RESTARTS   = 7        # starting points after the first success, for a nearer solution
MAX_STEPS        = 8        # largest number of steps from one starting point
SETTINGS_SIZE    = 9

# A seed is a column (dof + SEED_SIZE,): its joints, then, in the first joint's frame,
SEED_ROTATION    = 0        # (9,) the tool's R row by row
SEED_POSITION    = 9        # (3,) the tool's position, metres
SEED_RADIUS2     = 12       # the square of the tool's distance
SEED_Q1          = 13       # the first joint's position for this pose
SEED_COS_Q1      = 14       # (2,) cosine and sine of the first joint's free angle to either side
SEED_SIN_Q1      = 15
SEED_SIZE        = 16

# A result (2 * dof + RESULT_TAIL,): q, then -1, 0 or 1 per joint for the active limit, then
REACHED          = 0
POSITION_ERROR   = 1        # metres from the wanted position
ROTATION_ERROR   = 2        # radians from the wanted direction or orientation
REACHED_POINT    = 3        # (3,) the tool's position
ITERATIONS       = 6
SEED_INDEX       = 7        # the starting point from which it was found; 0 for the start
TRACE_LENGTH_OUT = 8        # number of filled rows of the trace
RESULT_TAIL      = 9

# A joint that does not move the tool (IDLE_WIDTH,).
IDLE_COLUMN      = 0        # index of the joint
IDLE_LOWER       = 1
IDLE_UPPER       = 2
IDLE_WIDTH       = 3
# fmt: on

# What ``solve_pose`` returns; 0 if the target is not reached. The last is added to one of the
# others.
INVALID, NOT_HOMOGENEOUS, IS_REACHED, IDLE_OUTSIDE = -1, -2, 1, 2

"""Mutants that are equivalent to the original, each with the reason."""

from __future__ import annotations

__all__ = ["EXCUSED"]

_NO_ZERO = "only keeps a division from zero: any tiny number does"
_TIE = "if _box_distance_at(ends, i, s, boxes, b) <= _box_distance_at(ends, i, t, boxes, b):"
_ANY_SMALL = "any value far below a tick keeps rounding from losing a limit"
_TICKS_INSIDE = "low, high = math.ceil(a - 1e-6), math.floor(b + 1e-6)"
_FINE = "any fine grid over the crank's rise finds the same steepest slope"
_ANGLES = "angles = (math.pi * k / 180.0 for k in range(181))"
_SECTIONS = "_SECTIONS = 40  # the rest of a segment of one metre is then 4 nm"
_SEARCH = "any section beyond the half finds the same valley"
_AS_FINE = "one section more or less of sixty makes no difference"
_VALLEY = "nearer = _box_distance_at(a, b, s, low_m, high_m) <= _box_distance_at("
_FINITE = "finite_vector(np.where(open_ended, 0.0, array), self.dof, what)"
_NO_OFFSET = 'offset = joint.servo.holds.get("homing_offset", 0)'
_HELPER = "any axis helps that is not parallel to the given one"
_WIDE = "wide = chain.upper_rad[i] - chain.lower_rad[i] >= _FULL_TURN_RAD"
_ANY_READING = "every reading has the same servos"
_ROWS = "return [[positions[i] for _, positions in self.readings] for i in self.readings[-1][1]]"
_MEANS = "return dict(zip(self.readings[-1][1], means, strict=True))"
_LEAST = "wide = (rows[0].range[0], rows[1].range[1])"
_ZERO_TICK = (
    "return anchor_tick - self.joint_map.with_mounting(sign, 0.0).ticks_from_zero(self.pose)"
)
_WHEREVER = "ticks are counted from zero, wherever that is"
_AMBIGUOUS = (
    "ambiguous = other_direction <= _MAX_TURNS_PER_S * self.ticks_per_turn * (at_s - self.at_s)"
)
_HELD = "return ChainJoint(self.joint, 0, 0.0, value).motion(_ORIGIN)"
_FALSE = "None is as false"
_TYPES = "is read by type checkers only"
_SERIES = "where the series begins both forms agree to the last digits"
_FINER = "the motion between two samples is below a millimetre after far fewer halvings"
_UNUSED_MEMORY = "memory may be wider than what is written to it"
_BUFFERS = "places, ends = np.empty((len(body.links), 12)), np.empty((len(body.capsules), 6))"
_ANY_STEPS = "other steps end in the same zero"
_SINGULAR = (
    "_ZERO = 1e-6  # a posture with a singular value below this is singular, m/rad or rad/rad"
)
_TO_THE_BIT = "no singular value is as large to the last bit"
_TOO_NEAR = (
    "return np.flatnonzero((free & may_touch & (nearer_m > 2 * _MAX_UNCHECKED_M)).any(axis=1))"
)
_DEEPER = "touching[-1] |= ~(gap_m[-1] >= np.minimum(gap_m[0], 0.0) - _SAME_M)"
_NO_TICK = "the bound is no whole number of ticks"
_DIRECTION = "subject, subject.free_direction if moved > 0 else -subject.free_direction"
_NO_UNIT = "the number of a lock has no unit"
_CHOSEN = "between what matters and what does not lie orders of magnitude"
_ANY_BELOW_ZERO = "NumPy takes any number below zero for the size that is left"
_BODIES = (
    "return np.tensordot(parameters.reshape(-1, len(PARAMETERS)), PSEUDO_INERTIA_BASIS, axes=1)"
)
_BOTH_WAYS = "short and long arrays are checked differently, with the same result"
_AS_IT_IS = "NumPy returns the same array, only later"
EXCUSED: dict[tuple[str, str, str], str] = {
    ("kinematics.arrays", "_FEW = 16", "number"): _BOTH_WAYS,
    **{
        ("kinematics.base_parameters", line, "number"): _CHOSEN
        for line in (
            "_TOLERANCE = 3e-5",
            "_ROUNDING = 1e-12  # of the largest effect",
            "_MOTIONS = 200",
            "TYPICAL_PARAMETERS = read_only([1.0, *[0.1] * 3, *[0.01] * 6])",
            "speed_rad_s: float = 3.0,",
            "acceleration_rad_s2: float = 10.0,",
            "seed: int = 0,",
        )
    },
    (
        "kinematics.base_parameters",
        "return independent_columns(Y.reshape(-1, Y.shape[-1]), typical, tolerance)",
        "1 -> 2",
    ): _ANY_BELOW_ZERO,
    ("kinematics.body_tree", "BASE = -1", "1 -> 2"): "any number below zero is no body",
    **{
        ("kinematics.body_tree", line, "1 -> 2"): _ANY_BELOW_ZERO
        for line in (
            "return (self.carries @ X.reshape(len(X), -1)).reshape(X.shape)",
            "return (self.carries.T @ X.reshape(len(X), -1)).reshape(X.shape)",
        )
    },
    (
        "kinematics.arrays",
        "if type(values) is np.ndarray and values.dtype is _FLOAT64 and values.shape == shape:",
        "never",
    ): _AS_IT_IS,
    (
        "kinematics.arrays",
        "if type(values) is np.ndarray and values.dtype is _FLOAT64:",
        "never",
    ): _AS_IT_IS,
    **{
        ("kinematics.arrays", line, kind): _BOTH_WAYS
        for line in (
            "array, is_short = array_of_shape(values, (size,), what), size <= _FEW",
            "is_short = array.ndim == 1 and len(array) <= _FEW",
        )
        for kind in ("LtE -> Lt", "LtE -> Gt")
    },
    (
        "kinematics.arrays",
        "if is_short and math.hypot(*array.tolist()) <= most:  # false for NaN, too",
        "never",
    ): _BOTH_WAYS,
    (
        "kinematics.arrays",
        "if is_short and math.hypot(*array.tolist()) <= most:  # false for NaN, too",
        "LtE -> Lt",
    ): _BOTH_WAYS,
    (
        "kinematics.arrays",
        "if is_short and math.isfinite(sum(array.tolist())):  # not where one of them is not",
        "never",
    ): _BOTH_WAYS,
    (
        "kinematics.inertia",
        _BODIES,
        "1 -> 2",
    ): _ANY_BELOW_ZERO,
    (
        "calibration.joint_map",
        "return -offset - offset * along / math.sqrt(self.rod_m**2 - offset**2)",
        "Sub -> Add",
    ): "the angles that are looked at lie on both sides of the dead centre",
    ("guard.collision_kernel", "_TINY = 1e-30", "number"): _NO_ZERO,
    (
        "guard.collision_kernel",
        "_SECTIONS = 40  # the rest of a segment of one metre is then 4 nm",
        "40 -> 41",
    ): ("one section more makes a right result finer"),
    (
        "guard.collision_kernel",
        _TIE,
        "LtE -> Lt",
    ): "of two equal ends of a convex valley either may be cut off",
    ("guard.collision", "_MAX_HALVINGS = 12", "12 -> 13"): _FINER,
    ("guard.collision", "_MAX_HALVINGS = 12", "12 -> 11"): _FINER,
    (
        "guard.collision",
        "_CHUNK = 8192  # postures at a time: each takes a number for every pair",
        "number",
    ): "how many postures are looked at together changes no distance",
    ("guard.collision", _TOO_NEAR, "Gt -> GtE"): "no interval is as wide to the last bit",
    ("guard.collision", _DEEPER, "GtE -> Gt"): "no contact is deeper by as much to the last bit",
    ("guard.collision", "free = np.minimum(gap_m[:-1], gap_m[1:]) >= -_TOUCH_M", "GtE -> Gt"): (
        "a distance of exactly a nanometre below zero does not occur"
    ),
    ("guard.collision", "may_touch = gap_m[:-1] + gap_m[1:] < nearer_m", "Lt -> LtE"): (
        "bodies that can just meet do not overlap"
    ),
    ("guard.collision", _BUFFERS, "12 -> 13"): _UNUSED_MEMORY,
    ("guard.collision", _BUFFERS, "6 -> 7"): _UNUSED_MEMORY,
    ("calibration.joint_map", _TICKS_INSIDE, "number"): _ANY_SMALL,
    ("calibration.joint_map", _ANGLES, "180.0 -> 225.0"): _FINE,
    ("calibration.joint_map", _ANGLES, "180.0 -> 144.0"): _FINE,
    ("calibration.joint_map", _ANGLES, "181 -> 182"): _FINE,
    ("calibration.joint_map", _ANGLES, "181 -> 180"): _FINE,
    ("kinematics.capsules", "_TINY = 1e-30", "number"): _NO_ZERO,
    ("kinematics.capsules", "_GOLDEN = (5**0.5 - 1) / 2", "5 -> 6"): _SEARCH,
    ("kinematics.capsules", "_GOLDEN = (5**0.5 - 1) / 2", "0.5 -> 0.625"): _SEARCH,
    ("kinematics.capsules", "for _ in range(60):", "number"): _AS_FINE,
    (
        "kinematics.conditioning",
        "_RANK = 1e-9",
        "number",
    ): "any value between rounding and what an arm's lengths give",
    ("kinematics.conditioning", "_SAMPLES = 5", "number"): (
        "more than one posture, in case that one is singular"
    ),
    ("kinematics.conditioning", "_STEPS = 40", "number"): "steps beyond those of a search",
    ("kinematics.conditioning", "_FRACTIONS = 0.5 ** np.arange(6)  # of Newton's step", "number"): (
        _ANY_STEPS
    ),
    ("kinematics.conditioning", _SINGULAR, "number"): "any value far below a usual one",
    ("kinematics.conditioning", "_DIFFERENCE_RAD = 1e-6", "number"): (
        "any small difference gives the derivative"
    ),
    ("kinematics.conditioning", "_MAX_STEP_RAD = 0.3", "number"): _ANY_STEPS,
    ("kinematics.conditioning", "_START_OFFSET_RAD = 0.7", "number"): _ANY_STEPS,
    ("kinematics.conditioning", "_MIN_DERIVATIVE = 1e-300", "number"): _NO_ZERO,
    ("kinematics.conditioning", "ends.append(q[values <= _ZERO])", "LtE -> Lt"): _TO_THE_BIT,
    (
        "kinematics.conditioning",
        "q, values = q[values > _ZERO], values[values > _ZERO]",
        "Gt -> GtE",
    ): _TO_THE_BIT,
    (
        "kinematics.conditioning",
        "if not len(q):",
        "never",
    ): "without starts the further steps do nothing; they are skipped to save time",
    (
        "kinematics.conditioning",
        "return int((values > _RANK).sum(axis=1).max())",
        "Gt -> GtE",
    ): _TO_THE_BIT,
    (
        "kinematics.capsules",
        _VALLEY,
        "LtE -> Lt",
    ): "of two equal ends of a convex valley either may be cut off",
    ("kinematics.chain", _FINITE, "number"): "any finite number stands for what may be infinite",
    (
        "kinematics.chain",
        "if step.scale:",
        "always",
    ): "a joint that nothing moves adds zero; it is skipped to save time",
    (
        "calibration.calibration_file",
        _NO_OFFSET,
        "number",
    ): "any small number stands for a missing register",
    (
        "calibration.lerobot",
        "_MAX_BYTES = 64 * 1024",
        "number",
    ): "any size far above that of a calibration",
    (
        "calibration.lerobot",
        "return found[0]",
        "0 -> -1",
    ): "there is exactly one",
    (
        "calibration.transaction",
        "if lock and bus.read(change.id, lock, raw=True) == 0:",
        "True -> False",
    ): _NO_UNIT,
    (
        "calibration.transaction",
        "bus.write(change.id, lock, 1, raw=True)",
        "True -> False",
    ): _NO_UNIT,
    (
        "calibration.transaction",
        "tables = parse_toml(path, strip_checksum(path, read_text(path, 4 * MAX_BYTES)))",
        "number",
    ): "two calibrations and a header fit into any of them",
    ("kinematics.packed", "WIDTH = 17", "17 -> 18"): _UNUSED_MEMORY,
    ("kinematics.se3", "_SMALL_RAD = 1e-4", "number"): _SERIES,
    ("kinematics.se3", "_NEAR_PI_RAD = 1e-3", "number"): _SERIES,
    ("kinematics.se3", "if math.pi - theta < _NEAR_PI_RAD:", "Lt -> LtE"): _SERIES,
    ("kinematics.se3", "if theta < _SMALL_RAD:", "Lt -> LtE"): _SERIES,
    (
        "kinematics.se3",
        "return axis_sin * (1.0 + theta * theta / 6.0 if theta < _SMALL_RAD else theta / sin)",
        "Lt -> LtE",
    ): _SERIES,
    (
        "kinematics.packed",
        "helper = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]",
        "Lt -> LtE",
    ): _HELPER,
    (
        "kinematics.packed",
        "helper = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]",
        "0.9 -> 0.7200000000000001",
    ): _HELPER,
    ("kinematics.packed", "helper = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]", "1 -> 2"): _HELPER,
    ("kinematics.packed", _WIDE, "GtE -> Gt"): "no range is as wide to the last bit",
    (
        "kinematics.collision",
        "size_m = self._size_m.get(capsule.link, 0.0)",
        "0.0 -> -1.0",
    ): "no capsule reaches less far than nowhere",
    (
        "calibration.range_tracker",
        "at_rad: float = 0.0",
        "number",
    ): "is not used before the first position sample",
    ("calibration.servo_config", _LEAST, "0 -> 1"): "both registers begin at the same number",
    ("calibration.servo_config", _LEAST, "0 -> -1"): "both registers begin at the same number",
    ("calibration.range_tracker", _ZERO_TICK, "0.0 -> 1.0"): _WHEREVER,
    (
        "calibration.range_tracker",
        _ZERO_TICK,
        "0.0 -> -1.0",
    ): _WHEREVER,
    ("calibration.range_tracker", _ROWS, "without USub"): _ANY_READING,
    ("calibration.range_tracker", _ROWS, "1 -> 2"): _ANY_READING,
    ("calibration.range_tracker", _ROWS, "1 -> 0"): _ANY_READING,
    ("calibration.range_tracker", _MEANS, "without USub"): _ANY_READING,
    ("calibration.range_tracker", _MEANS, "1 -> 2"): _ANY_READING,
    ("calibration.range_tracker", _MEANS, "1 -> 0"): _ANY_READING,
    (
        "kinematics.se3",
        "return -axis if float(axis @ axis_sin) < 0.0 else axis",
        "Lt -> LtE",
    ): "at exactly pi both signs are the same rotation",
    ("calibration.range_tracker", _AMBIGUOUS, "LtE -> Lt"): "no hand is as fast to the last bit",
    (
        "kinematics.joints",
        "_twist_squared: Matrix = field(init=False, repr=False)",
        "False -> True",
    ): ("how a step is shown"),
    (
        "kinematics.joints",
        "elif self.joint.kind is JointType.PRISMATIC:",
        "always",
    ): "the value of a fixed joint is zero",
    ("kinematics.joints", _HELD, "0 -> -1"): "the first of one number is the last",
    ("kinematics.joints", _HELD, "0.0 -> 1.0"): "what it scales is zero",
    ("kinematics.joints", _HELD, "0.0 -> -1.0"): "what it scales is zero",
    ("kinematics.joints", "_ORIGIN = read_only(np.zeros(1))", "1 -> 2"): _UNUSED_MEMORY,
    (
        "kinematics.joints",
        "return ChainJoint(joint, 0, 0.0, scale * _clamp_zero(leader) + shift)",
        "0 -> -1",
    ): "a column that is scaled by zero may be any",
    (
        "calibration.result",
        "if min(max(above, below), abs(shift)) > _max_shift(subject):",
        "Gt -> GtE",
    ): "no joint is off by as much to the last bit",
    ("calibration.procedure", "return False", "return None"): _FALSE,
    ("calibration.procedure", "_ALMOST_FULL_TURN = 2 / 360", "360 -> 359"): _NO_TICK,
    ("calibration.procedure", "_ALMOST_FULL_TURN = 2 / 360", "360 -> 361"): _NO_TICK,
    (
        "calibration.procedure",
        "return subject.name in known and width >= _COMPLETE * subject.expected_ticks",
        "GtE -> Gt",
    ): _NO_TICK,
    (
        "calibration.procedure",
        "return subject.expected_ticks >= _MAX_WIDTH_RATIO * subject.ticks_per_turn",
        "GtE -> Gt",
    ): _NO_TICK,
    (
        "calibration.procedure",
        "back = abs(moved) < _RETURNED_FRACTION * subject.min_motion_ticks",
        "Lt -> LtE",
    ): _NO_TICK,
    (
        "calibration.procedure",
        "if abs(moved) < subject.min_motion_ticks:",
        "Lt -> LtE",
    ): _NO_TICK,
    (
        "calibration.procedure",
        "returned: bool = False",
        "False -> True",
    ): "is set where a joint must be moved again",
    (
        "calibration.procedure",
        "return mismatches[sign] > _MIRRORED_RAD and mismatches[-sign] < mismatches[sign] / 3",
        "Gt -> GtE",
    ): "no gap is 30 degrees to the last bit",
    (
        "calibration.procedure",
        _DIRECTION,
        "number",
    ): "the joint has moved by many ticks",
    ("calibration.procedure", _DIRECTION, "Gt -> GtE"): "the joint has moved by many ticks",
    (
        "calibration.procedure",
        "return mismatches[sign] > _MIRRORED_RAD and mismatches[-sign] < mismatches[sign] / 3",
        "Lt -> LtE",
    ): "no gap is a third of the other to the last bit",
}
"""(module, line as it stands in the file, what the mutant does, or ``number`` for every number of
the line that is changed a little): why it is the same."""

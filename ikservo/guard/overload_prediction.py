"""Predict when a servo's overload protection acts, from how long and how hard its joint presses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.guard.driven_joint import DrivenJoint, TickRow


@dataclass(frozen=True, slots=True)
class OverloadRule:
    """The conditions, from registers or data sheet, under which a servo is overloaded.

    Attributes:
        output: Fraction of the full output, 0 to 1, above which a blocked servo is overloaded.
        time_s: Time after which the servo protects itself.
        output_per_rad: Fraction of the output per rad between goal and horn; 0 if unknown.
        torque_limit: Largest fraction of the output that the present limits allow.
        full_a: Current of the blocked motor at full output if the protection uses current; 0 if it
            uses output.
    """

    output: float
    time_s: float
    output_per_rad: float = 0.0
    torque_limit: float = 1.0
    full_a: float = 0.0


# A horn that has turned by no more than this is blocked (0.1 rad/s).
_STILL_RAD = 0.004
_STILL_S = 0.04  # time for which this turn is measured
# A goal acts before its effect is measured, so output this close to the limit counts as overload.
_NEAR = 0.92  # fraction of the limit above which overload begins
_ENDED = 0.88  # fraction of the limit below which it ends
# Output that has not exceeded the limit itself for this long stays below it: no servo trips.
_REACHED_S = 0.1
_RELAX_LEFT_S = 1.0  # the goal of a joint that has at most this time left is pulled back
_RELAXED_SHARE = 0.6  # fraction of the limit with which that joint still presses
# A joint that its load only just keeps from starting is near its reference.
_NEAR_REFERENCE_RAD = 0.045  # at the horn
_STARTING_S = 0.3  # time that such a joint has to start
_LOAD_AGE_S = 0.3  # a reading of the load is valid for this time


@dataclass(slots=True)
class _Pressing:
    """The state of one joint that may press against an obstacle.

    Attributes:
        tick: The position since ``still_s``, within the tolerance.
        output: Fraction of the output for its last goal.
        load: The last reading of the load as a signed fraction of the output.
        since_s: Time since which the joint presses beyond the limit; NaN if it does not.
        reached_s: Last time at which the output was beyond the limit.
        bound: The pulled-back goal, which the motion does not pass; None if it is not pulled back.
        warned: Whether the user was warned.
        side: 1 if the joint presses towards greater ticks, -1 if towards smaller ticks.
    """

    tick: int = 0
    still_s: float = math.nan
    output: float = 0.0
    load: float = 0.0
    load_s: float = -math.inf
    since_s: float = math.nan
    reached_s: float = -math.inf
    warned: bool = False
    bound: int | None = None
    side: int = 1


class OverloadMonitor:
    """Predictor, from goals and positions, of the time when a servo will protect itself.

    The duty of a position loop is ``kp (goal - position)``, which is known one cycle before a
    reading could show it; load readings are also used if there are any.

    Attributes:
        rules: The rules by joint; a joint without a rule is not watched.
        relaxes: Whether the goals of pressing joints are pulled back before the protection acts.
    """

    def __init__(self, driven_joints: Sequence[DrivenJoint]) -> None:
        self.rules: dict[str, OverloadRule] = {}
        self.relaxes = True
        self._columns = {driven.joint: column for column, driven in enumerate(driven_joints)}
        self._horn_rad = {d.joint: d.joint_map.horn_rad_per_tick for d in driven_joints}
        self._joints = {d.joint: _Pressing() for d in driven_joints}
        self._time_s = 0.0
        self._news: list[str] = []

    @property
    def relaxed_joints(self) -> tuple[str, ...]:
        """The joints whose goals are pulled back."""
        return tuple([name for name, joint in self._joints.items() if joint.bound is not None])

    def seconds_left(self, joint: str) -> float | None:
        """Compute the time for which a joint may stay overloaded; None if it is not overloaded."""
        since_s = self._joints[joint].since_s
        if math.isnan(since_s):
            return None
        return max(self.rules[joint].time_s - (self._time_s - since_s), 0.0)

    def observe_load(self, joint: str, load: float, time_s: float) -> None:
        """Process a reading of the load as a signed fraction of the full output."""
        state = self._joints.get(joint)
        if state is not None:
            state.load, state.load_s = load, time_s

    def observe_current(self, joint: str, current_a: float, time_s: float) -> None:
        """Process a current reading, signed or absolute, if the servo's protection uses it."""
        rule = self.rules.get(joint)
        if rule is not None and rule.full_a:
            self.observe_load(joint, current_a / rule.full_a, time_s)

    def update(
        self, goals: TickRow, ticks: TickRow, time_s: float, references: Sequence[int] | None = None
    ) -> tuple[str, ...]:
        """Process goals, and ticks of the joints that replied; return new warnings.

        Without references of the joints, the goals are used.
        """
        self._time_s = time_s
        warnings, self._news = self._news, []
        for name, rule in self.rules.items():
            column = self._columns[name]
            goal, tick = goals[column], ticks[column]
            if goal is not None and tick is not None:
                self._update_joint(name, rule, goal, tick)
                reference = goal if references is None else references[column]
                warnings += self._new_warning(name, rule, reference - tick)
        return tuple(warnings)

    def draw_back(self, goals: Sequence[int], ticks: TickRow) -> list[int]:
        """Pull back the goals of joints that have pressed for too long.

        Such a joint continues to press with 60 % of the output that its servo tolerates, until its
        goal returns or the obstacle gives way. It does not follow a load that pushes it back.
        """
        drawn = list(goals)
        for name in self.rules:
            joint, column = self._joints[name], self._columns[name]
            goal, tick = goals[column], ticks[column]
            presses = joint.warned or joint.bound is not None
            if not presses or tick is None or not self.relaxes:
                continue
            near, left_s = self._relaxed_goal(name, tick), self.seconds_left(name)
            is_short = joint.side * (goal - near) > 0
            if joint.bound is not None:
                joint.bound = joint.side * max(joint.side * joint.bound, joint.side * near)
            elif joint.warned and left_s is not None and left_s <= _RELAX_LEFT_S and is_short:
                joint.bound = near
                self._news.append(
                    f"The load of {name} was reduced {left_s:.1f} s before the servo would "
                    f"protect itself; its goal is kept close to the joint's position."
                )
            if joint.bound is None:
                continue
            if joint.side * (goal - joint.bound) <= 0:
                joint.bound = None
            else:
                drawn[column] = joint.bound
        return drawn

    def relaxed_goals(self, goals: TickRow, ticks: TickRow) -> list[int | None]:
        """Return goals moved towards the ticks for joints that press too hard after a motion.

        A goal that is already near enough is left out. No goal is moved away from the measured
        tick, because causes other than the lag, such as an I gain, may add to the measured load.
        """
        drawn: list[int | None] = [None] * len(goals)
        for name in self.rules:
            joint, column = self._joints[name], self._columns[name]
            goal, tick = goals[column], ticks[column]
            if goal is None or tick is None or not joint.warned or not self._is_beyond(joint):
                continue
            near = self._relaxed_goal(name, tick)
            if joint.side * (goal - near) > 0:
                drawn[column] = near
        return drawn

    def _is_beyond(self, joint: _Pressing) -> bool:
        return self._time_s - joint.reached_s <= _REACHED_S

    def _relaxed_goal(self, name: str, tick: int) -> int:
        rule = self.rules[name]
        if not rule.output_per_rad:
            return tick
        lag_rad = _RELAXED_SHARE * rule.output / rule.output_per_rad
        return tick + self._joints[name].side * int(lag_rad / self._horn_rad[name])

    def _update_joint(self, name: str, rule: OverloadRule, goal: int, tick: int) -> None:
        joint, horn_rad = self._joints[name], self._horn_rad[name]
        if math.isnan(joint.still_s) or abs(tick - joint.tick) * horn_rad > _STILL_RAD:
            joint.tick, joint.still_s = tick, self._time_s
        lag_rad = (goal - tick) * horn_rad
        before = joint.output
        joint.output = min(rule.output_per_rad * abs(lag_rad), rule.torque_limit)
        growing = max(joint.output - before, 0.0)
        share = min(joint.output + growing, rule.torque_limit)
        if self._time_s - joint.load_s < _LOAD_AGE_S:
            share = max(share, abs(joint.load))
        if share >= rule.output:
            joint.reached_s = self._time_s
        still = self._time_s - joint.still_s >= _STILL_S
        if not still or share < _ENDED * rule.output:
            joint.since_s, joint.warned = math.nan, False
        elif math.isnan(joint.since_s) and share >= _NEAR * rule.output:
            joint.since_s = self._time_s
            joint.side = 1 if (lag_rad or joint.load) > 0.0 else -1
        elif not self._is_beyond(joint):
            joint.since_s = max(joint.since_s, self._time_s - _REACHED_S)

    def _new_warning(self, name: str, rule: OverloadRule, off_ticks: int) -> list[str]:
        joint, left_s = self._joints[name], self.seconds_left(name)
        if left_s is None or joint.warned:
            return []
        starts = abs(off_ticks) * self._horn_rad[name] < _NEAR_REFERENCE_RAD
        output = max(joint.output, abs(joint.load))
        pressed_s = rule.time_s - left_s
        if starts and (output < rule.output or pressed_s < _STARTING_S):
            return []
        if pressed_s > 0.5 * _REACHED_S and not self._is_beyond(joint):
            return []
        joint.warned = True
        return [
            f"{name} presses with {100.0 * output:.0f} % of its output; "
            f"its servo's overload protection acts in {left_s:.1f} s."
        ]

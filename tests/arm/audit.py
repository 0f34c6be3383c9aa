"""An independent audit of the simulated servos: every write of a goal or of torque."""

import math
from dataclasses import dataclass, field

from tests.arm.simulated import line_of
from tests.oracle import arm_file, pinocchio_model

MAX_INTERVAL_S = 0.05  # no goal makes up for a longer pause
READ_S = 0.002  # from the reading of six servos to the first goal: 1 ms (so101), 2 ms (koch)
LOAD_LEAD_TICKS = 79  # largest lead of a goal at a joint that carries a load
# Joints that need more for the payload of their arm: 0.14 and 0.19 rad.
PAYLOAD_LEAD_TICKS = {("so101", "shoulder_lift"): 92, ("koch", "elbow_flex"): 124}
TRAVEL_TICKS = 60  # additional lead in motion


@dataclass
class Goal:
    time_s: float
    servo_id: int
    tick: int
    present: int
    last: int
    limp: bool


@dataclass
class TorqueOn:
    """Torque switched on at a limp servo: goal and present position in ticks, speed in ticks/s."""

    time_s: float
    servo_id: int
    goal: int
    present: int
    ticks_s: float


@dataclass
class Auditor:
    """Records all writes to the servos of an open arm, and finds faults in them.

    Attributes:
        punctual: Whether goals reach the servos as soon as the gate has passed them. If a program
            is paused before its write, two may come at once.
    """

    arm: object
    punctual: bool = True
    goals: list = field(default_factory=list)
    torque: list = field(default_factory=list)
    switched_on: list = field(default_factory=list)

    def __post_init__(self):
        self.line = line_of(self.arm)
        for servo in self.line.world.servos:
            servo.on_write = self._watcher(servo)
        self.limits = _limits(self.arm.model.name)
        self.eeprom_writes = lambda: sum(s.memory.eeprom_writes for s in self.line.world.servos)
        self._eeprom_before = self.eeprom_writes()
        self._goal_s, self._written = {}, {}

    def faults(self):
        """Return the faults of the goals; empty if there are none."""
        wrong = [w for goal in self.goals for w in self._judge(goal)]
        if self.eeprom_writes() != self._eeprom_before:
            wrong.append("EEPROM was written")
        return wrong

    def goals_after(self, time_s):
        return [goal for goal in self.goals if goal.time_s > time_s]

    def last_read_s(self, on):
        """Return when the joint of a servo was measured for the goal at which torque came on.

        Readings write nothing: all are measured in one transaction before the first goal.
        """
        first = min(goal.time_s for goal in self.goals if goal.limp and goal.time_s <= on.time_s)
        return first - READ_S

    def torque_on_after(self, time_s):
        return [at_s for at_s, _, on in self.torque if on and at_s > time_s]

    def _watcher(self, servo):
        table = servo.table.by_name

        def value(name, address, data):
            row, start = table[name], table[name].address - address
            inside = start >= 0 and start + row.size <= len(data)
            return row.decode(data[start : start + row.size]) if inside else None

        def ignores_goals(servo):
            """Return whether a tripped watchdog prevents the servo from accepting goals."""
            return "bus_watchdog" in table and servo.memory.get("bus_watchdog") == -1

        def watch(address, data):
            tick = value("goal_position", address, data)
            if tick is not None and servo.id in self.limits and not ignores_goals(servo):
                present, last = servo.read("present_position"), servo.memory.get("goal_position")
                limp = servo.memory.get("torque_enable") == 0
                self.goals.append(Goal(self.line.world.time_s, servo.id, tick, present, last, limp))
                if limp and servo.table.model.startswith("STS"):  # a goal turns their torque on
                    self.switched_on.append(self._torque_on(servo, tick))
            torque = value("torque_enable", address, data)
            if torque is not None:
                self.torque.append((self.line.world.time_s, servo.id, torque == 1))
                if torque == 1 and servo.memory.get("torque_enable") == 0:
                    goal = servo.memory.get("goal_position")
                    self.switched_on.append(self._torque_on(servo, goal))

        return watch

    def _torque_on(self, servo, goal):
        present = servo.read("present_position")
        ticks_s = servo.motor.velocity_rad_s * servo.table.ticks_per_turn / math.tau
        return TorqueOn(self.line.world.time_s, servo.id, goal, present, ticks_s)

    def _judge(self, goal):
        before_s = self._goal_s.get(goal.servo_id, goal.time_s - MAX_INTERVAL_S)
        self._goal_s[goal.servo_id] = goal.time_s
        low, high, ticks_s, at_rest = self.limits[goal.servo_id]
        elapsed_s = min(goal.time_s - before_s, MAX_INTERVAL_S) if self.punctual else MAX_INTERVAL_S
        elapsed_s += 0.002  # the world's own steps
        back = abs(goal.tick - goal.present) <= abs(goal.last - goal.present)  # nearer to the joint
        if not min(low, goal.last) <= goal.tick <= max(high, goal.last) and not back:
            yield f"{goal} is outside {low} to {high}"
        # A servo without torque does not move, and a restarted one has set its goal to where it
        # is: the next goal continues from the last one written.
        before = self._written.get(goal.servo_id, goal.last) if goal.limp else goal.last
        self._written[goal.servo_id] = goal.tick
        if abs(goal.tick - before) > ticks_s * elapsed_s + 2 and not back:
            yield f"{goal} is a jump after {elapsed_s:.3f} s"
        lead = at_rest + min(0.1 * ticks_s, TRAVEL_TICKS)
        if abs(goal.tick - goal.present) > lead + 0.02 * ticks_s and not (back or goal.limp):
            yield f"{goal} leads too far"


def _limits(name):
    """Return each servo's range, top speed per second and lead at rest, ticks, from the files."""
    arm, model = arm_file(name), pinocchio_model(name)
    ranges = {}
    for joint in arm["joints"]:
        servo = joint["servo"]
        place = model.joints[model.getJointId(joint["name"])].idx_q
        turn = servo.get("m_per_turn", 6.283185307179586)
        ends = [
            servo["zero_tick"] + servo["sign"] * 4096 * value / turn
            for value in (model.lowerPositionLimit[place], model.upperPositionLimit[place])
        ]
        ticks_s = 1.2 * arm["speeds"]["fast"]["deg_s"] * 4096 / 360
        at_rest = PAYLOAD_LEAD_TICKS.get((name, joint["name"]), LOAD_LEAD_TICKS)
        ranges[servo["id"]] = (min(ends) - 1, max(ends) + 1, ticks_s, at_rest)
    return ranges

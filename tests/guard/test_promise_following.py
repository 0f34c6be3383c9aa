"""M7: a joint that does not follow stops the arm within three cycles, by name."""

import itertools

import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.errors import RefusedError
from ikservo.motion import JointMove, KinematicLimits
from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.seeds import campaign, log, spread
from tests.arm.simulated import line_of, servo_group
from tests.oracle import arm_file

PACE = KinematicLimits(1.0, 3.0, 30.0)
JOINTS = {name: [joint["name"] for joint in arm_file(name)["joints"]] for name in ("so101", "koch")}
CASES = [(name, joint) for name in JOINTS for joint in JOINTS[name]]
LATEST_S = 0.9  # when there is still way enough to be noticed on


def jam(name, joint, after_s, port="sim"):
    """Return the number of last cycles with a jammed joint too far behind, and the refusal."""
    with ikservo.open_arm(name, port=port, collisions=False) as arm:
        arm.enable()
        servos, auditor = servo_group(arm), Auditor(arm)
        at, start = servos.names.index(joint), servos.goals()
        goal = start.copy()
        middle = [
            (driven.limits.lower.value + driven.limits.upper.value) / 2
            for driven in servos.driven_joints
        ]
        goal[at] += 1.2 if start[at] < middle[at] else -1.2
        driven, behind = servos.driven_joints[at], []
        most = 0.9 * driven.max_lead_ticks(PACE.speed_rad_s) * driven.joint_map.unit_per_tick
        fault = Fault("stuck", id=driven.servo_id, at_s=servos.clock.now_s() + after_s, for_s=60.0)
        line_of(arm).faults.add(fault)
        move = JointMove(start, goal, [PACE] * len(start))
        with pytest.raises(RefusedError) as caught:
            ControlLoop(servos).run(
                move,
                lambda cycle: behind.append(abs(cycle.goals[at] - cycle.measured[at]) > most),
                speed_rad_s=PACE.speed_rad_s,
            )
        assert auditor.faults() == [], (name, joint, after_s)
        return len(list(itertools.takewhile(bool, reversed(behind)))), str(caught.value)


@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "joint"), [*CASES[:6:2], CASES[7]])
def test_error_names_jammed_joint_within_3_cycles(name, joint):
    cycles, words = jam(name, joint, 0.4)
    assert words.startswith(f"{joint} does not follow its setpoint")
    assert cycles <= 3


@pytest.mark.parametrize("seeds", [campaign(25)])
@pytest.mark.parametrize(("name", "joint"), CASES)
def test_error_names_joint_jammed_at_any_time_within_3_cycles(name, joint, seeds, capsys):
    most = 0
    for seed in seeds:
        cycles, words = jam(name, joint, LATEST_S * spread(seed), f"sim:?seed={seed}")
        assert words.startswith(f"{joint} does not follow its setpoint"), seed
        most = max(most, cycles)
    log(capsys, f"{name} {joint}: {len(seeds)} jams named, at most {most} cycles too far behind")
    assert most <= 3

"""A fork of the process that opened an arm cannot use it and is told so at once."""

import os
import threading

import pytest

import ikservo
from ikservo.errors import BadValueError, RefusedError
from tests.arm.simulated import motion_runner
from tests.hardware.test_forked_children import in_fork


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as arm:
        yield arm


USES = {
    "move": lambda arm: arm.move_joints({"gripper": 0.3}),
    "queue": lambda arm: arm.move_joints({"gripper": 0.3}, wait=False),
    "jog": lambda arm: arm.jog("gripper", wanted=lambda: True),
    "measure": lambda arm: arm.where(),
    "stop": lambda arm: arm.stop(),
    "release": lambda arm: arm.disable_torque(),
    "relax": lambda arm: arm.relax(),
    "acknowledge": lambda arm: arm.acknowledge(),
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.parametrize("use", USES)
def test_forked_child_cannot_move_arm_while_parent_moves_it(arm, use):
    held, done = threading.Event(), threading.Event()

    def hold_lock():
        with motion_runner(arm).lock:
            held.set()
            done.wait(60)

    def use_arm():
        try:
            return USES[use](arm)
        except Exception as error:
            return str(error)

    threading.Thread(target=hold_lock).start()
    assert held.wait(60)
    try:
        answer = in_fork(use_arm)
    finally:
        done.set()
    assert f"opened by process {os.getpid()}; a forked process cannot use it" in answer


@pytest.mark.full
@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.parametrize("use", [lambda motion: motion.wait(5.0), lambda motion: motion.cancel()])
def test_forked_child_cannot_wait_for_or_cancel_a_motion(arm, use):
    def use_motion():
        try:
            return use(motion)
        except RefusedError as error:
            return str(error)

    with motion_runner(arm).lock:
        motion = arm.move_joints({"gripper": 0.3}, wait=False)
        answer = in_fork(use_motion)
    assert "a forked process cannot use it" in answer
    motion.wait()


@pytest.mark.parametrize("wait", [None, 0, 1, "no", 2.0])
def test_wait_keyword_accepts_only_booleans(arm, wait):
    with pytest.raises(BadValueError, match="wait"):
        arm.move_joints({"gripper": 0.3}, wait=wait)

"""An arm over the network has the methods, results and errors of an arm on a port."""

import inspect
import time

import numpy as np
import pytest

import ikservo
from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.remote_arm import RemoteArm
from ikservo.apps.teaching.mcap_recording import CALIBRATION_FILE, read_attachment
from ikservo.apps.teaching.replaying import Replay
from ikservo.arm import Arm, OpenArm, StopKind, StopReason, ToolOrientation
from ikservo.arm.opening import open_own_arm, require_own_port
from ikservo.arm.result_json import encode_fields
from ikservo.errors import (
    BadValueError,
    IkservoError,
    InputError,
    PortError,
    RefusedError,
    StoppedError,
    UnknownNameError,
    UnreachableError,
)
from ikservo.planning.motions import MoveArc, MoveGripper, MoveJoints, MovePose, MoveTo
from tests.apps.remote.conftest import until
from tests.arm.simulated import call_before, registers

POINT_M = (0.22, 0.05, 0.15)


def public_methods(kind):
    return {
        name: [p for p in inspect.signature(value).parameters if p not in ("arm", "self")]
        for name, value in inspect.getmembers(kind, callable)
        if not name.startswith("_")
    }


@pytest.mark.parametrize("kind", [Arm, RemoteArm])
def test_arm_and_remote_arm_implement_open_arm_protocol(kind):
    methods = public_methods(OpenArm)
    assert public_methods(kind).items() >= methods.items()
    names = {name for name in dir(OpenArm) if name[0] != "_"}
    assert all(hasattr(kind, name) for name in names)
    assert len(names) > len(methods) > 40


def test_remote_arm_lacks_only_listen_and_follow_goals_methods():
    left_out = {"listen", "follow_goals"}
    assert public_methods(Arm).keys() - public_methods(RemoteArm).keys() == left_out
    assert public_methods(Arm).keys() - public_methods(OpenArm).keys() == left_out


def test_remote_arm_has_limits_model_and_state_of_served_arm(served):
    with served.open() as arm:
        np.testing.assert_array_equal(arm.limits(), served.arm.limits())
        assert not any(side.flags.writeable for side in arm.limits())
        q = served.arm.chain.mid_range()
        np.testing.assert_allclose(arm.chain.forward(q), served.arm.chain.forward(q), atol=1e-12)
        np.testing.assert_allclose(arm.where().tip_m, served.arm.where().tip_m, atol=1e-3)
        assert arm.joint_names == served.arm.joint_names
        assert served.server.lease.holder is None  # looking takes no control


@pytest.mark.full
def test_remote_motion_returns_same_report_as_local_one(served):
    with served.open() as arm:
        there, here = arm.move_to(POINT_M), served.arm.move_to(POINT_M)
    assert type(there) is type(here)
    np.testing.assert_allclose(there.measured_tip_m, here.measured_tip_m, atol=1e-3)
    np.testing.assert_array_equal(there.target_m, POINT_M)
    assert there.reached


def test_unreachable_point_raises_same_error_on_remote_arm(served):
    with served.open() as arm:
        with pytest.raises(UnreachableError) as here:
            served.arm.move_to((0.9, 0.0, 0.1))
        with pytest.raises(UnreachableError) as there:
            arm.move_to((0.9, 0.0, 0.1))
    assert str(there.value) == str(here.value)
    np.testing.assert_allclose(there.value.nearest_m, here.value.nearest_m, atol=1e-6)
    assert there.value.exit_code is here.value.exit_code


def test_remote_plan_is_sampled_locally_and_executed_by_server(served):
    with served.open() as arm:
        plan = arm.plan_line(POINT_M)
        path = plan.sample(0.05)
        np.testing.assert_allclose(path.positions[-1], plan.goal, atol=1e-9)
        tips = arm.chain.forward(path.positions[:, : arm.chain.dof])[:, :3, 3]
        np.testing.assert_allclose(tips[-1], POINT_M, atol=1e-3)
        assert arm.execute(plan).reached


def test_remote_plan_matches_server_path_between_samples(served):
    with served.open() as arm:
        plan = arm.plan_to(POINT_M)
        own = served.server._plans.get(plan.trajectory.plan)
        for time_s in np.linspace(0.0, plan.duration_s, 37):
            there, here = own.trajectory.state(time_s), plan.trajectory.state(time_s)
            np.testing.assert_allclose(here.position, there.position, atol=1e-5)
            np.testing.assert_allclose(here.velocity, there.velocity, atol=1e-2)


def test_server_keeps_only_32_latest_plans(served):
    with served.open() as arm:
        first = arm.plan_joints({"gripper": 0.1})
        for _ in range(40):
            arm.plan_joints({"gripper": 0.2})
        assert len(served.server._plans) == 32
        with pytest.raises(RefusedError, match="no longer keeps"):
            arm.execute(first)


def test_plan_of_another_arm_is_refused(served):
    with served.open() as arm, pytest.raises(InputError, match="a plan of this arm"):
        arm.execute(served.arm.plan_joints({"gripper": 0.2}))


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "move",
    [
        lambda arm: arm.move_line(POINT_M, tool_speed_m_s=0.1),
        lambda arm: arm.move_through([(0.22, 0.0, 0.15), POINT_M], blend_m=0.01),
        lambda arm: arm.pose("home", speed="fast"),
        lambda arm: arm.gripper(width_m=None, to="close", force=0.4),
    ],
    ids=["line", "through", "pose", "gripper"],
)
def test_remote_motion_of_each_kind_reaches_target(served, move):
    with served.open() as arm:
        assert move(arm).reached


def test_remote_motion_reports_progress(served):
    seen = []
    with served.open() as arm:
        arm.move_joints({"shoulder_pan": 0.8}, on_progress=seen.append)
    assert seen
    assert seen[0].names == served.arm.joint_names


def test_error_in_progress_callback_stops_remote_arm(served):
    calls = []

    def fail(progress):
        calls.append(progress)
        raise ValueError("too near")

    with served.open() as arm:
        with pytest.raises(ValueError, match="too near"):
            arm.move_joints({"shoulder_pan": -1.5}, speed="slow", on_progress=fail)
        assert len(calls) == 1
        assert "too near" in served.arm.stopped_for
        assert served.arm.where()["shoulder_pan"].position_rad > -1.4


def test_remote_background_motion_returns_its_result(served):
    with served.open() as arm:
        motion = arm.move_joints({"gripper": 0.5}, wait=False)
        assert motion.wait(60.0).reached


def test_stop_ends_queued_motions_even_if_acknowledged(served):
    with served.open() as arm:
        before = served.arm.where()["gripper"].position_rad
        with served.arm.runner.lock:  # the server cannot begin the first one
            motions = [arm.move_joints({"gripper": x}, wait=False) for x in (0.5, 0.1, 0.6)]
            until(lambda: served.server.lease.moving is not None)
            arm.stop()
            arm.acknowledge()
        for motion in motions:
            with pytest.raises(StoppedError):
                motion.wait(60.0)
        assert abs(served.arm.where()["gripper"].position_rad - before) < 0.02


@pytest.fixture
def stopped_elsewhere(served):
    """Stop the arm from another program and acknowledge the stop at once."""
    other = served.connect()

    def stop_and_acknowledge():
        other.stop("test", "CLIENT")
        served.arm.acknowledge()

    yield stop_and_acknowledge
    other.close()


def test_stop_by_other_program_ends_locally_queued_motions(served, stopped_elsewhere):
    with served.open() as arm:
        before = registers(served.arm, "goal_position")
        with arm.background._turns.hold():  # none is sent before all are requested
            motions = [arm.move_joints({"gripper": x}, wait=False) for x in (0.5, 0.1, 0.6)]
            stopped_elsewhere()
        for motion in motions:
            with pytest.raises(StoppedError):
                motion.wait(60.0)
        assert registers(served.arm, "goal_position") == before
        assert arm.move_joints({"gripper": 0.3}).reached


@pytest.mark.parametrize(
    "request_motion",
    [
        lambda arm: arm.move_to(POINT_M),
        lambda arm: arm.draw([[POINT_M, (0.22, -0.05, 0.15)]]),
        lambda arm: arm.gripper("open"),
    ],
    ids=["move_to", "draw", "gripper"],
)
def test_stop_by_other_program_ends_motion_in_preparation(
    served, stopped_elsewhere, monkeypatch, request_motion
):
    with served.open() as arm:
        before = registers(served.arm, "goal_position")
        call_before(arm._calls, "start", monkeypatch, stopped_elsewhere)
        with pytest.raises(StoppedError):
            request_motion(arm)
        assert registers(served.arm, "goal_position") == before


@pytest.mark.full
@pytest.mark.parametrize(
    "go_on",
    [
        lambda arm: arm.move_joints({"gripper": 0.5}),
        lambda arm: arm.jog("gripper", 0.1, wanted=lambda: True),
        lambda arm: arm.follow([{"gripper": 0.5}] * 300),
        lambda arm: arm.relax(),
    ],
    ids=["move", "jog", "follow", "relax"],
)
def test_stop_by_other_program_between_steps_ends_program(served, stopped_elsewhere, go_on):
    with served.open() as arm, arm.background.requested():
        arm.move_joints({"gripper": 0.2})
        stopped_elsewhere()
        before = registers(served.arm, "goal_position")
        with pytest.raises(StoppedError):
            go_on(arm)
        assert registers(served.arm, "goal_position") == before


def test_cancelled_motion_does_not_end_queued_motions(served):
    with served.open() as arm:
        with arm.background._turns.hold():
            first, second = (arm.move_joints({"gripper": x}, wait=False) for x in (0.5, 0.1))
            first.cancel()
        assert second.wait(60.0).reached


def test_taught_pose_is_stored_with_served_arm(served):
    with served.open() as arm:
        arm.teach("cup")
        assert "cup" in arm.poses.user_poses()
        assert "cup" in served.arm.poses.user_poses()
        assert arm.pose("cup").reached


@pytest.mark.full
def test_remote_stop_lasts_until_acknowledged(served):
    with served.open() as arm:
        arm.move_joints({"gripper": 0.2})
        watcher = served.connect()
        watcher.stop("", "CLIENT")
        watcher.close()
        with pytest.raises(RefusedError, match="was stopped"):
            arm.move_joints({"gripper": 0.4})
        arm.acknowledge()
        assert arm.move_joints({"gripper": 0.4}).reached


@pytest.mark.parametrize("delays_s", [(0.2,), (0.2, 0.0)])
def test_acknowledge_waits_for_slow_stop_requests(served, monkeypatch, delays_s):
    stop, left_s = served.server.service.stop, list(delays_s)

    def stop_late(*args, **kwargs):
        time.sleep(left_s.pop(0))
        return stop(*args, **kwargs)

    monkeypatch.setattr(served.server.service, "stop", stop_late)
    with served.open() as arm:
        for _ in delays_s:
            arm.request_stop(StopReason(StopKind.CLIENT, "a test"))
        arm.acknowledge()
        time.sleep(0.3)
        assert arm.stop_reason is None


def test_stop_by_other_program_ends_remote_motion(served):
    watcher = served.connect()
    stopping = []

    def on_progress(progress):
        if progress.elapsed_s > 0.3 and not stopping:
            stopping.append(watcher.stop("test", "CLIENT", wait=False))

    with served.open() as arm:
        with pytest.raises(StoppedError):
            arm.move_joints({"shoulder_pan": 1.8}, speed="slow", on_progress=on_progress)
        assert arm.stop_reason.text == "test"
        assert arm.where()["shoulder_pan"].position_rad < 1.5
    watcher.close()


def test_require_own_port_refuses_remote_arm(served):
    with served.open() as arm:
        with pytest.raises(RefusedError, match=f"not on this machine: {served.address}"):
            require_own_port(arm)
        assert not hasattr(arm, "context")
    assert require_own_port(served.arm) is served.arm


def test_open_own_arm_refuses_address_of_other_machine(served):
    with pytest.raises(PortError, match="arm on another machine"):
        open_own_arm(served.arm.model, served.address)


def test_open_bus_refuses_address_of_other_machine(served):
    with pytest.raises(PortError, match="arm on another machine"):
        ikservo.arm.opening.open_bus(served.arm.model, served.address)


def test_model_that_differs_from_served_arm_is_refused(served):
    with pytest.raises(InputError, match="Choose so101"):
        ikservo.open_arm("koch", port=served.address)


def test_unknown_arm_name_error_lists_served_arms(served):
    with pytest.raises(PortError, match="Served there: desk"):
        ikservo.open_arm("so101", port=served.address.replace("desk", "bench"))


def test_options_for_local_ports_are_refused_on_remote_arm(served):
    with pytest.raises(InputError, match="another machine"):
        served.open(collisions=False)


def test_closed_remote_arm_refuses_motion(served):
    arm = served.open()
    arm.close()
    arm.close()
    with pytest.raises(PortError, match="closed"):
        arm.move_joints({"gripper": 0.1})


def test_connection_closes_even_if_background_close_fails(served, monkeypatch):
    arm = served.open()
    monkeypatch.setattr(arm.background, "close", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        arm.close()
    assert not arm._connection.is_open


def test_remote_recording_excludes_local_calibration(served, tmp_path, monkeypatch):
    monkeypatch.setattr("ikservo.apps.teaching.recorder.load_calibration", pytest.fail)
    with served.open() as arm:
        arm.zeros = ikservo.arm.ZeroSource.CALIBRATED
        result = arm.record(tmp_path / "a.mcap", duration_s=0.1)
    assert result.samples
    assert read_attachment(result.path, CALIBRATION_FILE) is None


def test_remote_pose_refuses_start_of_wrong_length(served):
    with served.open() as arm:
        for each in (served.arm, arm):
            with pytest.raises(BadValueError, match="The start"):
                each.pose_within_limits("home", np.zeros(2))


def test_unknown_option_raises_type_error_on_remote_arm(served):
    with served.open() as arm, pytest.raises(TypeError, match="argument 'sped'"):
        arm.move_to(POINT_M, sped="slow")


@pytest.mark.parametrize(
    "motion",
    [
        MoveTo((0.9, 0.0, 0.1), stance=ToolOrientation(pitch_rad=-1.0)),
        MoveArc(POINT_M, POINT_M),
        MoveJoints({"elbow": 0.1}),
        MovePose("nowhere"),
        MoveGripper(width_m=9.0),
        Replay("none.jsonl"),
    ],
    ids=str,
)
def test_impossible_motion_raises_same_error_on_remote_arm(served, motion):
    with served.open() as arm:
        with pytest.raises(IkservoError) as there:
            arm.execute(motion)
        if isinstance(motion, Replay):  # a file of that machine is none of this program's
            assert isinstance(there.value, RefusedError)
            return
        with pytest.raises(IkservoError) as here:
            served.arm.execute(motion)
    assert type(there.value) is type(here.value)
    assert there.value.message == here.value.message


def test_unknown_joint_is_refused_before_remote_request(served):
    with served.open() as arm, arm.stream() as stream, pytest.raises(UnknownNameError):
        stream.send({"elbow": 0.1})


@pytest.mark.parametrize(
    "setpoint",
    [POINT_M, {"elbow": 0.1}, {"gripper": np.nan}, np.full((4, 4), np.nan), "here"],
    ids=str,
)
def test_invalid_setpoint_raises_same_error_on_remote_arm(served, setpoint):
    with served.open() as arm:
        with pytest.raises(InputError) as there:
            arm.stream().send(setpoint)
        with pytest.raises(InputError) as here:
            served.arm.stream().send(setpoint)
    assert type(there.value) is type(here.value)
    assert there.value.message == here.value.message


@pytest.fixture
def described(served, monkeypatch):
    """Return a function that changes the served arm's description of itself."""
    right, watch = encode_fields(served.server.service.describe()), Connection.watch

    def describe(change):
        def answered(self, service, **arguments):
            return change(right) if service == "describe" else watch(self, service, **arguments)

        monkeypatch.setattr(Connection, "watch", answered)

    return describe


@pytest.mark.parametrize(
    "change",
    [
        lambda _: None,
        lambda right: {"arm": right["arm"]},
        lambda right: right | {"zeros": "guessed"},
        lambda right: right | {"lower": "low"},
    ],
    ids=["nothing", "name alone", "zeros", "limits"],
)
def test_incompatible_remote_arm_description_is_refused(served, described, change):
    described(change)
    with pytest.raises(IkservoError, match="unexpected reply"):
        served.open()


def test_remote_arm_description_may_have_unknown_fields(served, described):
    described(lambda right: right | {"weight_kg": 1.0})
    with served.open() as arm:
        assert arm.joint_names == served.arm.joint_names


REQUESTS = {
    "where": lambda arm: arm.where(),
    "last_state": lambda arm: arm.last_state(),
    "health": lambda arm: arm.health(),
    "stop_reason": lambda arm: arm.stop_reason,
    "clearance_m": lambda arm: arm.clearance_m(np.zeros(len(arm.joint_names))),
    "poses": lambda arm: arm.poses.all_poses(),
    "user_poses": lambda arm: arm.poses.user_poses(),
    "within_limits": lambda arm: arm.pose_within_limits("home"),
    "plan": lambda arm: arm.plan_to(POINT_M),
    "move": lambda arm: arm.move_to(POINT_M),
    "pose": lambda arm: arm.pose("home"),
    "gripper": lambda arm: arm.gripper(1.0),
    "jog": lambda arm: arm.jog("z", wanted=lambda: False),
    "follow": lambda arm: arm.follow([]),
    "relax": lambda arm: arm.relax(),
    "teach": lambda arm: arm.teach("cup"),
}


WRONG = [None, "text", [1.0, "x"], {"lease": ["x"]}]


@pytest.mark.full
@pytest.mark.parametrize("has_lease", [False, True], ids=["without lease", "with lease"])
@pytest.mark.parametrize("request_to", REQUESTS.values(), ids=REQUESTS)
def test_remote_result_of_wrong_type_raises_clear_error(monkeypatch, served, request_to, has_lease):
    with served.open() as arm:
        if has_lease:
            arm.enable()
        for wrong in WRONG:
            with monkeypatch.context() as patch:
                patch.setattr(
                    "ikservo.apps.remote.client_connection.result_of", lambda _, w=wrong: w
                )
                with pytest.raises(IkservoError, match="sent an unexpected reply"):
                    request_to(arm)
    served.arm.stop()

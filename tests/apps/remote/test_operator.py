"""Control of a served arm: streams, loss of the operator, malformed and old messages."""

import json

import pytest

import ikservo
from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.setpoint_inbox import SetpointInbox
from ikservo.apps.remote.wire_messages import (
    SCHEMA,
    Announcement,
    ServiceRequest,
    Setpoint,
    encode,
    result_of,
)
from ikservo.apps.remote.zenoh_session import ask
from ikservo.errors import (
    IkservoError,
    LatchedStopError,
    LeaseLostError,
    RefusedError,
    StoppedError,
)
from ikservo.ik import Target
from servosim.faults import Fault
from tests.apps.remote.conftest import TIMEOUT_S, until
from tests.arm.simulated import line_of, registers, true_joints

HOLD_S = 0.3


def joint_of(served, name):
    return true_joints(served.arm)[name]


def again(served, follow, is_done=None):
    """Follow again after a busy machine has delayed a target for longer than it is valid."""
    while True:
        try:
            result = follow()
        except (StoppedError, RefusedError):
            served.arm.acknowledge()
            continue
        if is_done is None or is_done():
            return result


@pytest.mark.full
def test_remote_streamed_goals_move_arm(served):
    with served.open() as arm:
        start = arm.where()["shoulder_pan"].position_rad
        with arm.stream(speed="fast", rate_hz=100) as stream:
            sent = 0
            while joint_of(served, "shoulder_pan") - start < 0.05:
                stream.send({"shoulder_pan": start + 0.15})
                sent += 1
    assert (stream.sent, stream.refused, stream.unreached) == (sent, 0, 0)


def test_setpoint_inbox_applies_end_to_its_own_stream_only(served):
    inbox, lease = SetpointInbox(), "ab"

    def sent(number, **goal):
        inbox.put(Setpoint(schema="ikservo/net/1", lease=lease, number=number, sent_s=0.0, **goal))

    sent(3, wanted=False)  # of the stream before
    sent(8, positions={"gripper": 0.1})
    inbox.begin(lease, 7)
    assert inbox.wanted
    assert inbox.take() == {"gripper": 0.1}
    sent(9, positions={"gripper": 0.2})
    sent(10, wanted=False)
    inbox.begin(lease, 8)
    assert not inbox.wanted
    inbox.begin("cd", 1)  # another operator, whose numbers are smaller
    assert (inbox.wanted, inbox.take()) == (True, None)


def test_remote_stream_without_goals_stops_arm(served):
    with served.open() as arm:
        served.server.lease.timeout_s = 1.0
        stream = arm.stream()
        stream.__enter__()
        stream.send(arm.where().positions_rad)
        until(lambda: served.arm.stop_reason is not None)
        with pytest.raises((StoppedError, RefusedError), match="No goal was received"):
            stream.__exit__(None, None, None)
        arm.acknowledge()


@pytest.mark.parametrize("goals", [0, 5])
def test_remote_follow_without_goals_stops_arm_and_latches(served, goals):
    def targets():
        yield from [{"wrist_roll": joint_of(served, "wrist_roll")}] * goals
        while True:
            yield None

    with served.open() as arm:
        served.server.lease.timeout_s = 1.0
        with pytest.raises((StoppedError, RefusedError), match=r"No goal was received for 0\.3 s"):
            arm.follow(targets())
        assert "No goal was received" in served.arm.stop_reason.text
        with pytest.raises(LatchedStopError):
            arm.enable()
        arm.acknowledge()


def test_old_or_repeated_leader_states_are_dropped(served):
    seen, leader = [], served.connect()
    key, now_s = keys.news("desk", "test"), served.server._clock.now_s

    def publish(number, sent_s, value):
        served.server._session.put(key, encode(Announcement(
            schema="ikservo/net/1", number=number, sent_s=sent_s, value=value)))  # fmt: skip

    with leader.subscribed("test", seen.append):
        until(lambda: _publishes(publish, 1, now_s(), "first", seen))
        publish(9, now_s(), "newer")
        publish(9, now_s(), "repeated")
        publish(8, now_s(), "overtaken")
        publish(10, now_s() - 1.0, "old")
        publish(11, now_s() + 1.0, "ahead")
        publish(12, now_s(), "last")
        until(lambda: "last" in seen)
    assert seen == ["first", "newer", "last"]
    leader.close()


def _publishes(publish, number, sent_s, value, seen):
    publish(number, sent_s, value)
    return bool(seen)


def test_silent_local_leader_stops_remote_follower(served):
    with served.open() as arm, ikservo.open_arm("so101", port="sim:?pose=home") as leader:
        served.server.lease.timeout_s = 1.0
        line_of(leader).faults.add(Fault("silent", id=3))
        with pytest.raises((StoppedError, RefusedError), match="No goal was received"):
            arm.follow_arm(leader)
        arm.acknowledge()


def test_remote_stream_may_end_before_its_first_goal(served):
    with served.open() as arm:
        with arm.stream() as stream:
            pass
        assert stream.refused == 0
        assert served.arm.stop_reason is None


def test_remote_stream_accepts_targets_joints_and_poses(served):
    with served.open() as arm:
        state = arm.where()
        goals = (
            Target(state.tip_m),
            state.positions_rad,
            arm.chain.forward(state.positions_rad[: arm.chain.dof]),
        )
        with arm.stream(rate_hz=50) as stream:
            for goal in goals:
                stream.send(goal)
    assert (stream.unreached, stream.refused) == (0, 0)


def test_remote_follow_reaches_goal_and_reports(served):
    with served.open() as arm:
        goal = arm.where()["wrist_roll"].position_rad + 0.1

        def goals():
            while abs(joint_of(served, "wrist_roll") - goal) > 0.02:
                yield {"wrist_roll": goal}

        result = again(served, lambda: arm.follow(goals(), speed="fast"))
    assert result.setpoints > 0
    assert result.measured_rad["wrist_roll"] == pytest.approx(goal, abs=0.04)


@pytest.mark.full
def test_remote_arm_follows_local_leader(served):
    there = joint_of(served, "wrist_roll") + 0.2
    with served.open() as arm, ikservo.open_arm("so101", port="sim:?pose=home") as leader:
        leader.move_joints({"wrist_roll": there})
        is_there = lambda: abs(joint_of(served, "wrist_roll") - there) < 0.05  # noqa: E731
        result = again(served, lambda: arm.follow_arm(leader, until=is_there))
    assert result.refused == 0
    assert joint_of(served, "wrist_roll") == pytest.approx(there, abs=0.1)


@pytest.mark.campaign
def test_local_arm_follows_remote_leader(served):
    there = joint_of(served, "wrist_roll")
    with served.open() as leader, ikservo.open_arm("so101", port="sim:?pose=home") as arm:

        def is_there():
            return abs(true_joints(arm)["wrist_roll"] - there) < 0.05

        arm.move_joints({"wrist_roll": there - 0.3})
        assert not is_there()
        result = again(served, lambda: arm.follow_arm(leader, until=is_there))
    assert result.setpoints > 0
    assert result.measured_rad["wrist_roll"] == pytest.approx(there, abs=0.1)


def test_remote_jog_continues_while_requested(served):
    with served.open() as arm:
        before = joint_of(served, "wrist_roll")

        def has_moved():
            return joint_of(served, "wrist_roll") - before > 0.05

        result = again(served, lambda: arm.jog("wrist_roll", 0.3, wanted=lambda: not has_moved()),
                       has_moved)  # fmt: skip
    assert result.measured_rad["wrist_roll"] - before > 0.04


def test_second_operator_is_refused_until_first_disconnects(served):
    first, second = served.open(), served.open()
    first.enable()
    with pytest.raises(RefusedError, match="controls the arm"):
        second.enable()
    first.close()
    second.enable()
    second.close()


def lose(served, how):
    """Stream from a client that is then lost; return once the server has noticed."""
    arm = served.open()
    stream = arm.stream(speed="fast")
    stream.__enter__()
    goal = arm.where().positions_rad
    for _ in range(5):
        stream.send(goal)
    until(lambda: served.server.lease.moving is not None)
    how(arm._connection)
    until(lambda: served.arm.stop_reason is not None)
    until(lambda: served.server.lease.moving is None)
    return arm


def test_silent_operator_loses_lease_and_arm_holds(served):
    def fall_silent(connection):
        connection.send_setpoint = lambda **goal: None
        served.server.lease.timeout_s = HOLD_S

    arm = lose(served, fall_silent)
    assert "nothing was received from" in served.arm.stopped_for
    served.server.lease.timeout_s = TIMEOUT_S
    with pytest.raises(LeaseLostError):
        arm.acknowledge()
    arm._connection.__class__.send_setpoint(arm._connection)
    with pytest.raises(RefusedError, match="was stopped"):
        arm.enable()  # under a lease of its own, and still not without acknowledgement
    arm.close()


def test_closed_operator_connection_is_detected_at_once(served):
    def cut(connection):
        connection._closed.set()
        connection._session.close()

    arm = lose(served, cut)  # its messages count for a minute
    assert "connection to" in served.arm.stopped_for
    arm._connection.forget_lease()  # ends its thread


def test_goals_of_disconnected_operator_are_dropped(served):
    def lose_lease(connection):
        served.server.service.lose(served.server.lease.holder, "test")

    arm = lose(served, lose_lease)
    before, dropped = registers(served.arm, "goal_position"), served.server.lease.dropped
    for _ in range(5):
        arm._connection.send_setpoint(positions={"wrist_roll": 1.0})
    until(lambda: served.server.lease.dropped >= dropped + 5)
    assert registers(served.arm, "goal_position") == before
    arm._connection.forget_lease()
    arm.close()


def goals_sent(arm):
    return registers(arm, "goal_position")


MALFORMED = [
    b"", b"\xff", b"{}", b"null", b"[]", b"1e999", b'{"schema":"ikservo/net/2"}',
    b"[" * 50_000, b'{"schema":"ikservo/net/1","lease":"../../etc"}',
    b'{"schema":"ikservo/net/1","arguments":{"motion":{"move_to":{"position_m":[0,0,"x"]}}}}',
    b'{"schema":"ikservo/net/1","arguments":{"__class__":1},"more":2}',
    b'{"schema":"ikservo/net/1","arguments":{"motion":{"move_to":{"position_m":[0,0,1%s]}}}}'
    % (b"0" * 400),
    b'{"schema":"ikservo/net/1","arguments":{"motion":{"hop":{}}}}',
    b'{"schema":"ikservo/net/1","arguments":{"motion":{"replay":{"path":"/etc/passwd"}}}}',
    b'{"schema":"ikservo/net/1","arguments":{"positions":{"gripper":1%s}}}' % (b"0" * 400),
    b'{"schema":"ikservo/net/1","number":-1}', b"x" * 1_000_001,
    b"cposix\nsystem\n(S'true'\ntR.", b'{"schema":"ikservo/net/1","sent_s":1e30}',
]  # fmt: skip


@pytest.mark.parametrize("payload", MALFORMED, ids=range(len(MALFORMED)))
def test_malformed_messages_are_refused_and_move_nothing(served, payload):
    client = served.connect()
    before = goals_sent(served.arm)
    for key in (keys.drive("desk", "move"), keys.drive("desk", "plan"),
                keys.drive("desk", "nonsense"),
                keys.watch("desk", "clearance"), keys.watch("desk", "__init__")):  # fmt: skip
        answers = ask(client._session, key, payload, 5.0)
        assert len(answers) == 1
        with pytest.raises(IkservoError):
            result_of(answers[0][1])
    client._session.put(keys.setpoint("desk"), payload)
    assert client.watch("clock") > 0
    assert goals_sent(served.arm) == before
    client.close()


@pytest.mark.parametrize(
    "goal",
    [{"positions": {"wrist_roll": "nan"}}, {"positions": {"nope": 0.1}}, {"pose": [0.2, 0.0, 0.1]},
     {"pose": [["nan"] * 4] * 4},
     {"target": {"position_m": ["inf", 0, 0], "tool_axis": [0, 0, 1]}}],
    ids=["nan", "no joint", "no pose", "nan pose", "inf target"],
)  # fmt: skip
@pytest.mark.parametrize("service", ["stream", "follow"])
def test_invalid_remote_goal_moves_nothing(served, service, goal):
    client = served.connect()
    before = goals_sent(served.arm)
    pending = client.start(service, speed="fast")
    until(lambda: served.server.lease.moving is not None or pending.done)
    for number in range(10**6, 10**6 + 5):
        raw = {"schema": "ikservo/net/1", "lease": client._lease, "number": number, **goal}
        client._session.put(
            keys.setpoint("desk"), json.dumps(raw | {"sent_s": client._server_now_s()})
        )
    client._session.put(keys.setpoint("desk"), json.dumps(
        raw | {"sent_s": client._server_now_s(), "number": 10**6 + 9, "wanted": False}
        | dict.fromkeys(goal)))  # fmt: skip
    until(lambda: pending.done)
    after = goals_sent(served.arm)
    assert all(abs(after[i] - before[i]) <= 2 for i in before)
    client.close()


OPEN = {"move_gripper": {"to": "open"}}


@pytest.mark.parametrize("ahead", [1, 2, 2**53])
def test_stop_ends_queued_motion_even_if_stop_count_is_higher(served, ahead):
    before, count = goals_sent(served.arm), served.arm.background.stop_count + ahead
    request = ServiceRequest(schema=SCHEMA, stop_count=min(count, 2**53))
    arrived = served.server._requested(request)  # and waits for its turn
    served.arm.stop("test")
    served.arm.acknowledge()
    with arrived, pytest.raises(StoppedError):
        served.arm.gripper("open")
    assert goals_sent(served.arm) == before


def test_replayed_message_is_refused_and_moves_nothing(served):
    client = served.connect()
    lease = client.acquire()
    number = next(client._numbers)
    sent = client._request({"motion": OPEN}, lease=lease, number=number)
    key = keys.drive("desk", "move")
    first = client._send(key, sent, TIMEOUT_S)
    until(lambda: first.done)
    first.result()
    before = goals_sent(served.arm)
    again = [client._send(key, sent, TIMEOUT_S) for _ in range(20)]
    for each in again:
        until(lambda each=each: each.done)
        with pytest.raises(IkservoError):
            each.result()
    assert goals_sent(served.arm) == before
    client.close()


@pytest.mark.full
def test_message_flood_does_not_delay_stop(served):
    client, other = served.connect(), served.connect()
    request = other._request({})
    flood = [other._send(keys.watch("desk", "health"), request, TIMEOUT_S) for _ in range(500)]
    for _ in range(500):
        other._session.put(keys.setpoint("desk"), b"x" * 1000)
    client.stop("test", "CLIENT")
    assert served.arm.stop_reason is not None
    until(lambda: all(each.done for each in flood))
    assert other.watch("clock") > 0
    served.arm.acknowledge()
    client.close()
    other.close()


@pytest.mark.parametrize(("operator", "shown"), [("bob\n\rmallory", "bob mallory"),
                                                 (" \n", "somebody")])  # fmt: skip
def test_line_breaks_in_remote_names_are_removed(served, operator, shown):
    client = served.connect()
    key, request = keys.drive("desk", "lease"), client._request({"operator": operator})
    lease = result_of(ask(client._session, key, request, 5.0)[0][1])["lease"]
    client.stop("it\nburns", "PROGRAM")
    health = client.watch("health")
    assert (health["operator"], health["stop_text"]) == (shown, "it burns")
    served.server.service.release(lease)
    client.close()


def test_remote_motion_without_control_lease_is_refused(served):
    client = served.connect()
    with pytest.raises(LeaseLostError):
        client.plan("move", motion={"move_to": {"position_m": [0.2, 0.0, 0.15]}})
    client.close()


@pytest.mark.parametrize("service", ["plan", "move"])
def test_replay_of_recording_on_remote_machine_is_refused(served, service):
    client = served.connect()
    with pytest.raises(RefusedError, match="only on the arm's computer"):
        client.drive(service, motion={"replay": {"path": "/etc/passwd"}})
    client.close()


def test_motion_request_to_all_arms_is_refused(served):
    client = served.connect()
    answers = ask(client._session, keys.drive("*", "move"), client._request({}), 5.0)
    assert len(answers) == 1
    with pytest.raises(IkservoError, match="one arm"):
        result_of(answers[0][1])
    client.close()


def test_releasing_control_during_motion_stops_arm(served):
    with served.open() as arm:

        def give_back(progress):
            if arm._connection._lease:
                arm._connection.release()

        with pytest.raises(StoppedError):
            arm.move_joints({"shoulder_pan": -1.5}, speed="slow", on_progress=give_back)
        assert "released control" in served.arm.stopped_for
        arm.acknowledge()


def test_closing_server_ends_motion(served):
    with served.open() as arm:

        def close(progress):
            if progress.elapsed_s > 0.2:
                served.server.service.end_motion("closing")

        with pytest.raises(StoppedError):
            arm.move_joints({"shoulder_pan": -1.5}, speed="slow", on_progress=close)

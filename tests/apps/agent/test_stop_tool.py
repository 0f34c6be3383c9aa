"""The agent's stop ends a motion within 0.3 s, whatever other calls wait."""

import anyio
import pytest

PACED = "sim:?pose=home&paced=1"


@pytest.mark.parametrize("after_s", [0.05, 0.6, 1.5])
def test_stop_tool_ends_motion_within_300_ms(open_session, after_s):
    with open_session(port=PACED) as session:
        turn = {"positions": {"shoulder_pan": 1.5}, "speed": "normal"}
        plan = session.plan(move_joints=turn)
        world = session.audit.line.world
        stopped_s = []

        async def work(client):
            async with anyio.create_task_group() as group:
                group.start_soon(client.call_tool, "execute", {"plan_id": plan})
                for _ in range(5):
                    group.start_soon(client.call_tool, "where", {})
                await anyio.sleep(after_s)
                await client.call_tool("stop", {"reason": "test"})
                stopped_s.append(world.time_s)

        session.run(work)
        late = session.audit.goals_after(stopped_s[0] + 0.35)
        assert [goal for goal in late if abs(goal.tick - goal.last) > 1] == []
        assert "The agent stopped the arm" in session.agent.arm.stopped_for
        assert abs(session.agent.arm.where().positions["shoulder_pan"]) < 1.4


@pytest.mark.parametrize("reason", [None, 7, "x" * 100_000, ["a"], {"b": 1}])
def test_stop_tool_latches_with_any_value_as_reason(simulated, reason):
    plan = simulated.plan(move_joints={"positions": {"shoulder_pan": 0.2}})
    stopped = simulated.call("stop", reason=reason)
    assert "A person must end the stop" in str(stopped)
    assert len(simulated.agent.arm.stopped_for) < 200
    refused = simulated.call("execute", plan_id=plan)
    assert isinstance(refused, str)
    assert not simulated.has_moved


def test_agent_errors_after_stop_do_not_name_python_methods(simulated):
    assert simulated.call("gripper", to="open")["status"] == "done"
    assert simulated.call("where")["is_holding"]
    simulated.call("stop", reason="test")
    assert simulated.call("where")["is_holding"]  # the servos still hold
    refused = simulated.call("gripper", to="close")
    assert "A person must end the stop" in refused
    assert "arm." not in refused


def test_stop_reply_of_limp_arm_does_not_claim_that_it_holds(simulated):
    assert "holds" not in str(simulated.call("stop", reason="test"))
    assert not simulated.call("where")["is_holding"]

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

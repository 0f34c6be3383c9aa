"""The tools of an agent: typed, planned before anything moves, each plan executed once."""

import json

import jsonschema
import numpy as np
import pytest

from ikservo.apps.agent.agent_journal import read_journal
from ikservo.apps.agent.allowance import Consent
from ikservo.planning.path_constraint import PathConstraint
from tests.arm.simulated import true_tip_m

NEAR = [0.22, 0.04, 0.12]


def test_every_mcp_tool_has_valid_schema_and_description(simulated):
    async def tools(client):
        return (await client.list_tools()).tools

    listed = simulated.run(tools)
    assert {"list_arms", "where", "reachable", "plan", "execute", "gripper", "stop", "scene_add",
            "scene_list", "scene_remove", "look", "program_check", "explain"} <= {
        each.name for each in listed
    }  # fmt: skip
    for each in listed:
        jsonschema.Draft202012Validator.check_schema(each.input_schema)
        if each.output_schema:
            jsonschema.Draft202012Validator.check_schema(each.output_schema)
        assert each.description


def test_plan_tool_accepts_each_kind_of_motion_with_units(simulated):
    async def schema(client):
        return next(t for t in (await client.list_tools()).tools if t.name == "plan").input_schema

    kinds = simulated.run(schema)["$defs"]
    assert {
        "MoveTo",
        "MoveLine",
        "MoveArc",
        "MoveThrough",
        "Draw",
        "MoveJoints",
        "MovePose",
    } <= set(kinds)
    tool_speed = kinds["MoveLine"]["properties"]["tool_speed_m_s"]
    assert "tip speed" in tool_speed["description"].lower()


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_agent_plan_can_be_executed_only_once(simulated, mode):
    async def move(client):
        planned = await client.call_tool("plan", {"motion": {"move_to": {"position_m": NEAR}}})
        assert not simulated.has_moved
        plan = {"plan_id": planned.structured_content["plan_id"]}
        return [await client.call_tool("execute", plan) for _ in range(2)]

    first, second = simulated.run(move, mode)
    assert first.structured_content["status"] == "done"
    assert np.linalg.norm(true_tip_m(simulated.agent.arm) - NEAR) < 0.003
    assert second.is_error
    assert "already been used" in second.content[0].text
    assert simulated.audit.faults() == []


def test_plan_picture_tool_returns_png(simulated):
    plan = simulated.plan(move_to={"position_m": NEAR})
    (picture,) = simulated.call("plan_picture", plan_id=plan)
    assert picture.mime_type == "image/png"


def test_agent_cannot_remove_scene_objects_of_owner(simulated):
    simulated.agent.arm.scene.add("box", "wall", center_m=(0.3, 0.3, 0.1), size_m=(0.1, 0.1, 0.1))
    assert "no thing of the agent named 'wall'" in simulated.call("scene_remove", name="wall")
    added = simulated.call("scene_add", kind="sphere", name="ball", center_m=[0.1, 0.3, 0.1],
                           radius_m=0.02)  # fmt: skip
    assert [each["is_own"] for each in added["result"]] == [False, True]
    assert len(simulated.call("scene_remove", name="ball")["result"]) == 1


def test_explain_tool_says_why_a_point_is_refused(simulated):
    assert "cannot be reached" in simulated.plan(move_to={"position_m": [1.5, 0.0, 0.1]})
    (refusal,) = simulated.call("explain")["result"]
    assert refusal["kind"] == "UnreachableError"
    assert len(refusal["details"]["nearest_m"]) == 3


def test_agent_stop_stays_until_a_person_acknowledges_it(simulated):
    plan = simulated.plan(move_to={"position_m": NEAR})
    simulated.call("stop", reason="a\x1b[2Jb")
    assert "stopped" in simulated.call("execute", plan_id=plan)
    assert simulated.call("where")["stopped_for"] == "The agent stopped the arm: a\\x1b[2Jb"
    assert not simulated.has_moved
    simulated.agent.acknowledge("a person")
    again = simulated.plan(move_to={"position_m": NEAR})
    assert simulated.call("execute", plan_id=again)["status"] == "done"


def test_agent_program_is_checked_and_run_as_one_plan(simulated):
    text = f'format = 1\narm = "so101"\n[[steps]]\ntip_m = {NEAR}\n[[steps]]\nwait_s = 1.0\n'
    checked = simulated.call("program_check", text=text)
    assert [step["error"] for step in checked["steps"]] == ["", ""]
    assert not simulated.has_moved
    done = simulated.call("execute", plan_id=checked["plan"]["plan_id"])
    assert len(done["results"]) == 2
    impossible = simulated.call("program_check", text=text.replace("0.22", "2.2"))
    assert impossible["plan"] is None
    assert "cannot be reached" in impossible["steps"][0]["error"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x", "is not TOML"),
        ('format = 1\narm = "koch"\n[[steps]]\nwait_s = 1.0\n', "is for koch"),
        (
            'format = 1\narm = "so101"\nrepeat = 1000\n[[steps]]\nwait_s = 1.0\n',
            "repetitions is 1000",
        ),
        (
            'format = 1\narm = "so101"\n[[steps]]\nrecording = "/etc/passwd"\n',
            "cannot be planned in advance",
        ),
        ('format = 1\narm = "so101"\n[[steps]]\nprogram = "/etc/passwd"\n', "not a fixed list"),
    ],
)
def test_agent_program_check_reports_why_program_cannot_run(simulated, text, words):
    assert words in simulated.call("program_check", text=text)


def test_mcp_resources_describe_arm_and_its_state(simulated):
    async def read(client):
        return [(await client.read_resource(f"arm://{name}")).contents[0].text
                for name in ("description", "state")]  # fmt: skip

    description, state = map(json.loads, simulated.run(read))
    assert set(description["limits"]) == set(state["positions"])
    assert "home" in description["poses"]


def test_limits_set_by_owner_apply_to_every_agent_motion(open_session):
    region = PathConstraint(low_m=(0.1, -0.2, 0.05), high_m=(0.4, 0.2, 0.4))
    with open_session(consent=Consent.SLOW, within=region, motions=2) as session:
        fast = session.call("plan", motion={"move_to": {"position_m": NEAR, "speed": "fast"}})
        assert ", slow," in fast["summary"][0]
        assert session.call("execute", plan_id=fast["plan_id"])["status"] == "done"
        outside = session.plan(move_to={"position_m": [0.2, 0.25, 0.12]})
        assert "cannot be reached" in outside or "box" in outside
        own = {"move_to": {"position_m": NEAR, "within": {"above_m": [0, 0, 0]}}}
        assert "The owner has already constrained the tool" in session.call("plan", motion=own)
        assert "cannot be kept within the owner's region" in session.call(
            "plan", motion={"move_to_rest": {}}
        )
        session.call("execute", plan_id=session.plan(move_to={"position_m": [0.22, 0, 0.12]}))
        third = session.plan(move_to={"position_m": NEAR})
        session.agent.ask(third, "test")
        assert [each.id for each in session.agent.plans.asked()] == [third]
        assert session.audit.faults() == []


def test_agent_journal_records_call_consent_and_result(simulated):
    plan = simulated.plan(move_to={"position_m": NEAR})
    simulated.call("execute", plan_id=plan)
    text = "\n".join(read_journal(simulated.agent.journal.path))
    for words in ("planned", plan, "allowed_by: --allow simulator", "done"):
        assert words in text


def test_agent_moves_nothing_without_journal_entry(simulated, monkeypatch):
    plan = simulated.plan(move_to={"position_m": NEAR})
    monkeypatch.setattr("ikservo.apps.agent.agent_journal.MAX_BYTES", 10)
    assert "the journal is full" in simulated.call("execute", plan_id=plan)
    assert not simulated.has_moved


def test_agent_plan_made_before_stop_is_never_executed(simulated):
    plan = simulated.plan(move_to={"position_m": NEAR})
    simulated.call("stop")
    simulated.agent.acknowledge("a person")
    assert "stopped after this motion had been requested" in simulated.call("execute", plan_id=plan)
    assert not simulated.has_moved


def test_agent_call_cancelled_before_motion_moves_nothing(simulated, monkeypatch):
    plan, write = simulated.plan(move_to={"position_m": NEAR}), simulated.agent.journal.write

    def cancelled(event, **values):
        if event == "execute":
            simulated.agent.hold("cancelled")
        write(event, **values)

    monkeypatch.setattr(simulated.agent.journal, "write", cancelled)
    assert "cancelled" in simulated.call("execute", plan_id=plan)
    assert not simulated.has_moved


def test_agent_journal_names_client_and_is_private(simulated):
    simulated.call("execute", plan_id=simulated.plan(move_to={"position_m": NEAR}))
    path = simulated.agent.journal.path
    (asked,) = (each for each in read_journal(path) if " asked " in each)
    assert "client: mcp" in asked
    assert path.stat().st_mode & 0o077 == 0


def test_agent_program_is_refused_if_arm_has_moved_since(simulated):
    text = f'format = 1\narm = "so101"\n[[steps]]\ntip_m = {NEAR}\n'
    checked = simulated.call("program_check", text=text)["plan"]["plan_id"]
    moved = simulated.plan(move_joints={"positions": {"shoulder_pan": 0.5}})
    assert simulated.call("execute", plan_id=moved)["status"] == "done"
    assert "not where the program begins" in simulated.call("execute", plan_id=checked)


def test_consent_request_shows_program_steps_and_speeds(simulated):
    step = f'[[steps]]\nname = "{"harmless " * 8}"\ntip_m = {NEAR}\nspeed = "fast"\n'
    text = f'format = 1\narm = "so101"\nrepeat = 3\n{step}'
    summary = simulated.call("program_check", text=text)["plan"]["summary"]
    assert summary == ["1: joints to (0.220, 0.040, 0.120) m, fast", "all steps 3 times"]


def test_program_outside_allowed_region_is_not_offered(open_session):
    region = PathConstraint(low_m=(0.1, -0.2, 0.05), high_m=(0.4, 0.2, 0.4))
    text = 'format = 1\narm = "so101"\n[[steps]]\ntip_m = [0.2, 0.25, 0.12]\n'
    with open_session(consent=Consent.SLOW, within=region) as session:
        checked = session.call("program_check", text=text)
        assert checked["plan"] is None
        assert checked["steps"][0]["error"]


def test_long_errors_to_the_agent_are_truncated(simulated):
    words = simulated.call("program_check", text="a" * 40_000 + " = 1")
    assert len(words) < 1200
    assert len(json.dumps(simulated.call("explain"))) < 1500


def test_person_acknowledges_stop_even_if_journal_is_full(simulated, monkeypatch):
    simulated.call("stop")
    monkeypatch.setattr("ikservo.apps.agent.agent_journal.MAX_BYTES", 10)
    simulated.agent.acknowledge("a person")
    assert simulated.agent.arm.stop_reason is None

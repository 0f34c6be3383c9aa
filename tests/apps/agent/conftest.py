"""Fixtures for tests of the agent's server: an arm, its owner's decisions, and a client."""

from contextlib import contextmanager

import anyio
import pytest

import ikservo

pytest.importorskip("mcp")

from mcp.client.client import Client

from ikservo.apps.agent.agent_arm import AgentArm
from ikservo.apps.agent.agent_journal import AgentJournal
from ikservo.apps.agent.allowance import Allowance, Consent
from ikservo.apps.agent.mcp_server import make_server
from tests.arm.audit import Auditor


class Session:
    """An agent's arm with a client that calls its tools one after the other."""

    def __init__(self, agent):
        self.agent, self.audit = agent, Auditor(agent.arm)
        self.server = make_server(agent)

    def run(self, work, mode="auto"):
        """Run an async function of a connected client, and return its result."""

        async def connected():
            async with Client(self.server, mode=mode) as client:
                return await work(client)

        return anyio.run(connected)

    def call(self, tool, **arguments):
        """Call a tool; return its structured result, or the text of its error."""

        async def call(client):
            result = await client.call_tool(tool, arguments)
            if result.is_error:
                return result.content[0].text
            return result.structured_content or result.content

        return self.run(call)

    def plan(self, **motion):
        planned = self.call("plan", motion=motion)
        return planned["plan_id"] if isinstance(planned, dict) else planned

    @property
    def has_moved(self):
        return bool(self.audit.goals)


@pytest.fixture
def open_session(tmp_path):
    """Return a context manager that opens an arm for an agent."""

    @contextmanager
    def session(name="so101", port="sim:?pose=home", consent=Consent.SIMULATOR, **allowance):
        with ikservo.open_arm(name, port=port) as arm:
            journal = AgentJournal(name, tmp_path / "journal")
            yield Session(AgentArm(arm, Allowance(consent, **allowance), journal))

    return session


@pytest.fixture
def simulated(open_session):
    """Return a session whose owner allows every motion of the simulated arm."""
    with open_session() as session:
        yield session

"""Server of the Model Context Protocol for agents, with plans, consent and a journal."""

from ikservo.app import App, Command

APP = App(
    name="agent",
    commands={
        "mcp": Command(
            "ikservo.apps.agent.mcp_command",
            "Let a language model plan motions; a person allows each one.",
            "Other machines",
        ),
    },
)

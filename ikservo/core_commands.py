"""The commands of the core, declared like those of an app."""

from __future__ import annotations

from ikservo.app import App, Command

PANELS = (
    "Without an arm",
    "Set up",
    "Move",
    "Teach and replay",
    "Other machines",
    "Stop and recover",
)
"""The headings of ``--help``, in their order."""

CORE = App(
    name="core",
    commands={
        "arms": Command(
            "ikservo.cli.commands.arms", "List the arms that ship with ikservo.", "Without an arm"
        ),
        "solve": Command(
            "ikservo.cli.commands.solve",
            "Find joint positions for a point; nothing moves.",
            "Without an arm",
        ),
        "scene": Command(
            "", "List the things in a scene file, and the poses that touch them.", "Without an arm"
        ),
        "scene show": Command(
            "ikservo.cli.commands.scene:show", "List names, positions and sizes.", "Without an arm"
        ),
        "scene check": Command(
            "ikservo.cli.commands.scene:check",
            "Show which poses of an arm touch something.",
            "Without an arm",
        ),
        "workspace": Command(
            "ikservo.cli.commands.workspace",
            "Compute what the tip can reach; test a point, draw a picture.",
            "Without an arm",
        ),
        "sim": Command(
            "ikservo.cli.commands.sim",
            "Serve a simulated arm on a pseudo-terminal.",
            "Without an arm",
        ),
        "ports": Command(
            "ikservo.cli.commands.ports",
            "List the USB adapters: chip, stable name, who uses them.",
            "Set up",
        ),
        "where": Command(
            "ikservo.cli.commands.where",
            "Show where the arm is: tip, joints, limits, health.",
            "Move",
        ),
        "move": Command("ikservo.cli.commands.move", "Move the tip to a point.", "Move"),
        "arc": Command("ikservo.cli.commands.arc", "Move the tip on an arc or a circle.", "Move"),
        "joints": Command("ikservo.cli.commands.joints", "Move single joints.", "Move"),
        "pose": Command("ikservo.cli.commands.pose", "Move to a named pose.", "Move"),
        "jog": Command(
            "ikservo.cli.commands.jog", "Move a joint or the tip while a key is held.", "Move"
        ),
        "gripper": Command("ikservo.cli.commands.gripper", "Open, close, grasp.", "Move"),
        "stop": Command(
            "ikservo.cli.commands.stop",
            "Stop the arm now, whichever program moves it.",
            "Stop and recover",
        ),
        "relax": Command(
            "ikservo.cli.commands.relax",
            "Lower the arm to its rest pose and switch torque off.",
            "Stop and recover",
        ),
        "recover": Command(
            "ikservo.cli.commands.recover", "Clear overload and other alarms.", "Stop and recover"
        ),
    },
)

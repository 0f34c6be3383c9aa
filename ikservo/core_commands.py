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

_ROWS = {
    "Without an arm": (
        ("arms", "arms", "List the arms that ship with ikservo."),
        ("solve", "solve", "Find joint positions for a point; nothing moves."),
        ("scene", "", "List the things in a scene file, and the poses that touch them."),
        ("scene show", "scene:show", "List names, positions and sizes."),
        ("scene check", "scene:check", "Show which poses of an arm touch something."),
        ("workspace", "workspace", "Compute what the tip can reach; test a point, draw a picture."),
        ("sim", "sim", "Serve a simulated arm on a pseudo-terminal."),
    ),
    "Set up": (("ports", "ports", "List the USB adapters: chip, stable name, who uses them."),),
    "Move": (
        ("where", "where", "Show where the arm is: tip, joints, limits, health."),
        ("move", "move", "Move the tip to a point."),
        ("arc", "arc", "Move the tip on an arc or a circle."),
        ("joints", "joints", "Move single joints."),
        ("pose", "pose", "Move to a named pose."),
        ("jog", "jog", "Move a joint or the tip while a key is held."),
        ("gripper", "gripper", "Open, close, grasp."),
    ),
    "Stop and recover": (
        ("stop", "stop", "Stop the arm now, whichever program moves it."),
        ("relax", "relax", "Lower the arm to its rest pose and switch torque off."),
        ("recover", "recover", "Clear overload and other alarms."),
    ),
}
"""The commands by heading: name, place below ``ikservo.cli.commands``, line for the list."""

CORE = App(
    name="core",
    commands={
        name: Command(f"ikservo.cli.commands.{place}" if place else "", text, panel)
        for panel, rows in _ROWS.items()
        for name, place, text in rows
    },
)

"""``ikservo scene``: list the things in a scene file, and the poses that touch them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.errors import ExitCode
from ikservo.model.scene_file import read_scene_with_arms, with_scene_and_arms

if TYPE_CHECKING:
    from ikservo.model import Model

SceneFile = Annotated[Path, typer.Argument(metavar="FILE", help="TOML file, as for --scene.")]


def show(file: SceneFile, *, json: JsonOption = False) -> None:
    """List the things and other arms in a scene file: names, positions and sizes.

    ikservo scene show table.toml
    """
    things, arms = read_scene_with_arms(file)
    if json:
        rows = [{"name": e.name, "low_m": e.low_m, "high_m": e.high_m} for e in things]
        print_json("scene", things=rows, arms=[asdict(each) for each in arms])
        return
    if arms:
        print_table(
            ["arm", "base [m]", "roll, pitch, yaw [°]", "port"],
            [[e.name, _triple(e.at_m), _triple(e.rpy_deg), e.port or "–"] for e in arms],
        )
    if not arms or things:
        print_table(
            ["thing", "from [m]", "to [m]"],
            [[each.name, _triple(each.low_m), _triple(each.high_m)] for each in things],
        )


def check(file: SceneFile, arm: ArmOption = None, *, json: JsonOption = False) -> None:
    """Show which poses of an arm touch a thing in a scene file; nothing moves.

    ikservo scene check table.toml --arm so101
    """
    model, arms = with_scene_and_arms(model_from_option(arm), file)
    touched = list(_touched(model))
    if json:
        print_json(
            "scene-check",
            touched=[
                {"pose": pose, "link": link, "thing": thing, "depth_m": depth_m}
                for pose, link, thing, depth_m in touched
            ],
            unchecked=[each.name for each in arms],
        )
    elif touched:
        print_lines(
            f"{pose}: {link} touches {thing}, {depth_m * 1e3:.1f} mm deep"
            for pose, link, thing, depth_m in touched
        )
    else:
        print_lines(["No pose of the arm touches anything in the scene."])
    if arms and not json:
        names = ", ".join(each.name for each in arms)
        print_status(
            f"Not checked: {names}. Other arms are measured only in a motion or in ikservo view."
        )
    if touched:
        raise typer.Exit(ExitCode.FAILED)


def _touched(model: Model) -> Iterator[tuple[str, str, str, float]]:
    """Yield each pose that touches a thing, with the link, the thing and the depth [m]."""
    from ikservo.arm.opening import make_collision_checker  # noqa: PLC0415  # loads the kernels

    checker = make_collision_checker(model)
    names = [*model.chain.names, *([model.gripper.joint] if model.gripper else [])]
    for pose, positions in model.poses.items():
        q = [positions[name] for name in names[: checker.dof]]
        for (link, thing), gap_m in zip(checker.pairs, checker.distances([q])[0], strict=True):  # pyright: ignore[reportArgumentType]
            if thing in checker.things and gap_m < 0.0:
                yield pose, link, thing, -float(gap_m)


def _triple(at: tuple[float, float, float]) -> str:
    return ", ".join(f"{x:.3f}" for x in at)

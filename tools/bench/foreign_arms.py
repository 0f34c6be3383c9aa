"""Import arms that others have published, move them in the simulator, compare with Pinocchio.

    python tools/bench/foreign_arms.py LIST [NAME ...]

A line of LIST is a name, the path of a description from LIST's folder, and options of
``ikservo arms new``: facts that the description lacks. Arms are written to ``imported`` beside
LIST. Pinocchio reads the published description if it can, otherwise the imported arm.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import shlex
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import ikservo
from ikservo.cli.entry_point import main
from ikservo.errors import IkservoError

MOVES, SPREAD = 3, 0.25


def import_arm(name: str, source: Path, options: list[str], folder: Path) -> str:
    """Import an arm into a folder; return the error, empty if there is none."""
    errors = io.StringIO()
    arguments = ["arms", "new", name, "--from", str(source), "--folder", str(folder), *options]
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        code = main(arguments)
    return " ".join(errors.getvalue().split())[-300:] if code else ""


def judged_tip_m(source: Path, folder: Path, positions: dict[str, float]) -> tuple[str, np.ndarray]:
    """Compute the tip in the frame of the arm's base by Pinocchio, from the published file."""
    pin: Any = importlib.import_module("pinocchio")
    model = ikservo.load_model(folder)
    readers = {".urdf": pin.buildModelFromUrdf, ".xml": pin.buildModelFromMJCF}
    for path in (source, folder / "arm.urdf"):
        with contextlib.suppress(ValueError, RuntimeError, KeyError, IndexError):
            judge = readers[path.suffix](str(path))
            links = model.chain.base, model.chain.tip
            base, tip = (judge.getFrameId(link, pin.BODY) for link in links)
            if max(base, tip) >= judge.nframes and path == source:
                continue
            q = pin.neutral(judge)
            for joint, at in positions.items():
                body = judge.joints[judge.getJointId(joint)]
                q[body.idx_q : body.idx_q + body.nq] = (
                    at if body.nq == 1 else (np.cos(at), np.sin(at))
                )
            data = judge.createData()
            pin.framesForwardKinematics(judge, data, q)
            whose = "published" if path == source else "own"
            return whose, (data.oMf[base].inverse() * data.oMf[tip]).translation
    return "nobody", np.full(3, np.nan)


def move_arm(source: Path, folder: Path) -> str:
    """Move an arm in the simulator; return a line of results."""
    model, rng = ikservo.load_model(folder), np.random.default_rng(3)
    home, reached, errors, whose, why = (
        model.chain_pose("home"), 0, list[float](), "", "",
    )  # fmt: skip
    span = SPREAD * np.minimum(model.chain.upper_rad - model.chain.lower_rad, 2.0)
    goals = model.chain.clip(home + span * (rng.random((MOVES, len(home))) - 0.5))
    with ikservo.open_arm(folder, port="sim:?pose=home", uncalibrated=True) as arm:
        for goal in [*goals, None]:
            try:
                if goal is None:
                    arm.move_joints(model.pose("rest"))
                    continue
                wanted_m = model.chain.forward(goal)[:3, 3]
                reached += arm.move_to(wanted_m).reached
                whose, tip_m = judged_tip_m(source, folder, dict(arm.where().positions))
                errors.append(1000.0 * float(np.linalg.norm(tip_m - wanted_m)))
            except IkservoError as error:
                why += f" {'rest' if goal is None else 'move'}: {error.message}"
                arm.acknowledge()
    error = f"{max(errors):.1f} mm ({whose})" if errors else "-"
    return f"{model.chain.dof} joints, {reached} of {MOVES} reached, at most {error}{why}"


def run(lines: list[str], place: Path, wanted: list[str]) -> None:
    """Import and move the arms of a list."""
    for line in lines:
        name, path, *options = shlex.split(line)
        if wanted and name not in wanted:
            continue
        for old in (place / "imported").glob(f"{name}*"):
            shutil.rmtree(old)
        start_s = time.process_time()
        refused = import_arm(name, place / path, options, place / "imported")
        head = f"{name}: {time.process_time() - start_s:.0f} s, {len(options)} options"
        if refused:
            print(f"{head}: {refused}", flush=True)
        for folder in sorted((place / "imported").glob(f"{name}*")):
            try:
                print(f"{head}: {move_arm(place / path, folder)}", flush=True)
            except IkservoError as error:
                print(f"{head}: {error.message}", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("IKSERVO_HOME", str(Path(sys.argv[1]).parent / "imported" / ".home"))
    listed = Path(sys.argv[1]).read_text().splitlines()
    kept = [line for line in listed if line.strip() and not line.startswith("#")]
    run(kept, Path(sys.argv[1]).resolve().parent, sys.argv[2:])

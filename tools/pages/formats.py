"""Pages of ``arm.toml``, of programs and recordings, and of the messages of the page."""

from __future__ import annotations

import inspect
import json
from dataclasses import fields
from typing import get_args

from pydantic import BaseModel

from ikservo.apps.page import arm_list
from ikservo.apps.page.messages import page_messages as messages
from ikservo.apps.page.panels import servo_bench
from ikservo.apps.page.server import message_age_and_rate as connection
from ikservo.apps.teaching import program, recording
from ikservo.apps.teaching.program import Program
from ikservo.apps.teaching.recording import RecordingHeader
from ikservo.model.arm_schema import ArmFile
from ikservo.planning.motions import KINDS
from pages.markdown import code, table
from pages.schemas import describe_type, model_sections

__all__ = ["arm_toml_page", "page_protocol_page", "programs_page"]

_ARM_TOML = """# arm.toml

This page is generated from the schema that reads the file (`ikservo/model/arm_schema.py`). An
unknown key, a wrong type or a value outside its bounds is refused with its place in the file.
[Add your own arm](../how-to/own-arm.md) explains a whole file step by step.

- A joint of type `prismatic` (it slides) has a `servo` with `m_per_turn` or `crank`.
- `zero_from = "vendor"`: the maker fixes the zero, no calibration is needed. `"nominal"`: zeros
  differ from arm to arm, the arm is calibrated before it moves.
- Names of joints and links are those of the URDF.
"""

_PROTOCOL = """# Protocol of the page

The page of `ikservo view` and its server exchange JSON texts over two websockets: `/live/ARM` for
the arm that is shown, `/live` for the first, and `/arms` for the list of arms. This page is made
from the models that check the messages (`messages/page_messages.py`, `arm_list.py` and
`panels/servo_bench.py` in `ikservo/apps/page`). Everything else is refused, and nothing changes.

## From the connection to the first scene

1. The server sends `{{"kind": "challenge", "nonce": …}}`.
2. The page answers with `hello`: its `proof` is the HMAC-SHA-256 of the nonce with the key after
   `#token=` in the address. The key itself is never sent.
3. From then on the server sends scenes and states, and the page sends the messages below. Each has
   `seq`, which increases, and `seen`, the number of the last scene that it has drawn.

| bound | value |
| --- | --- |
| longest message | {bytes} bytes |
| oldest scene to which a command may answer | {age_s:g} s |

An older command, a repeated `seq` and a message with a number out of its bounds are dropped.
`stop`, `viewport` and the `heartbeat` of a hidden page are accepted at any age.

## What the page draws from

The server sends no polygons: the page computes the drawing (`static/picture.js` in 2D,
`scene3d.js` in 3D) from the arm, which is sent once, and from the scenes. Lengths are metres,
angles rad, poses (4, 4) row by row.

`graph`, before the first scene and when the arm was opened again:

- `links`, from base to tip: `name`, `parent`, `origin` (T_parent_link at position 0), `joint`
  (`fixed`, `revolute` or `prismatic`), its `axis`, and `capsules` (`ends`, `radius`) in the link's
  frame.
- `dials` of the joints: `joint`, `link` that it moves, direction of the `needle`, `slides`, `range`
  (null if it turns freely), and the distances from a limit at which it is `at` it or `near` it.
- `tip`, `boxes` to keep out of (`name`, `low`, `high`), height of the `floor`, `centre` and `size`
  of the drawing, and what the `handles` of the tool can move.

`shapes`, once to a page that draws in 3D: the visual shapes of all links, by link.

`scene`, whenever something has changed: only the keys that have. Keys of a scene:

- `camera`: `pose`, `scale_px` (pixels for a metre, or the focal length of a `perspective`),
  `near_m`, `size` of the drawing in CSS pixels; `lens` of a calibrated camera (`focal`, `centre`,
  `distortion`, `widest`), else null.
- `measured`, `goal` (null if it is the measured position): positions of the joints that are not
  fixed, in the order of the links.
- `path` to the goal, null without one: its `number`, `joints` (positions at even times along it);
  `swept`: those of them at which the whole arm is drawn, null while the goal is dragged.
- `marker` of the target: `target`, `nearest`, `reached`; `refused_pair`: the parts that would
  touch, null if nothing is refused; `refusal`: why. `limp`: the joints without torque.
- `hover`, `grabbed`, `picked`, `behind`: what is under the pointer, and how it is marked.
- `region` (rings) that the tip can reach, and its `region_pose`.
- `trace` of a solver method (`lines`, `target`, `reached`), and `trace_step`, the shown iteration.
- `handles`: the axes of the tool in 3D; `webgl`: whether it is to be drawn in 3D; `seq`.
- `picture_trouble`: why the picture of a calibrated camera takes no targets; null in other views.
- `tip_shows`: the joint whose zero a click on the tip determines there; null if there is none.
- `tip_clicks`: the number of clicks on the tip in its calibration; 0 in other views.

## Messages of the page
"""

_SERVOS = """## Messages to the page of servos

The server answers with `line` (the servos that reply), `servo` (a table), `note` and `plots`;
`read_servo` and `write_register` as above."""

_LIST = """## Messages to the list of arms

The server answers each change with `arms`: the open arms, and those that could be opened."""


def arm_toml_page() -> str:
    """Return the reference of ``arm.toml`` as Markdown."""
    return f"{_ARM_TOML}\n{model_sections(ArmFile)}\n"


def programs_page() -> str:
    """Return the formats of programs and recordings as Markdown."""
    names = [each.name for each in fields(RecordingHeader)]
    columns = [(code(name), _attribute(RecordingHeader, name)) for name in names]
    return (
        "\n\n".join(
            [
                "# Programs and recordings",
                "This page is made from the models that read the files.",
                "## Programs",
                "`ikservo program new FILE` writes a first program. An example:",
                _example(program.__doc__, "toml"),
                model_sections(Program, 3),
                "### Motions",
                "The key `motion` of a step has one of these, with its fields; `speed` is a key of "
                "the step. Python makes them in `ikservo.planning.motions`.",
                *(_motion_section(name, kind) for name, kind in KINDS.items()),
                "## Recordings",
                "JSON Lines, written by `ikservo record`: a header, then one line per sample.",
                _example(recording.__doc__, "text"),
                table(["key of the header", "meaning"], columns),
                "In each sample `t_s` is the time since the start and `q` the joints, in the order "
                "and the units of the header. `ikservo export csv FILE` makes a table of it.",
            ]
        )
        + "\n"
    )


def _motion_section(name: str, kind: type) -> str:
    text = (inspect.getdoc(kind) or "").replace("``", "`").partition("\n\nRaises:")[0]
    text, _, attributes = text.partition("\n\nAttributes:")
    listed = _attributes(attributes)
    for field in fields(kind):
        default: object = field.default
        if isinstance(default, (str, bool, int, float, tuple)):
            words = f"- `{field.name}` (default `{json.dumps(default)}`):"
            listed = listed.replace(f"- `{field.name}`:", words)
    return f"#### {name}\n\n{text}\n\n{listed}".rstrip()


def _attribute(owner: type, name: str) -> str:
    lines = (inspect.getdoc(owner) or "").splitlines()
    found = [line.strip() for line in lines if line.strip().startswith(f"{name}: ")]
    return found[0].partition(": ")[2].replace("``", "`") if found else ""


def _example(doc: str | None, language: str) -> str:
    """Return the literal block of a docstring (after ``::``) as a fence."""
    block = (doc or "").partition("\n::\n\n")[2]
    lines: list[str] = []
    for line in block.splitlines():
        if line and not line.startswith("    "):
            break
        lines.append(line.removeprefix("    "))
    return f"```{language}\n" + "\n".join(lines).strip() + "\n```"


def page_protocol_page() -> str:
    """Return the messages that a page may send as Markdown."""
    introduction = _PROTOCOL.format(
        bytes=messages.MAX_MESSAGE_BYTES, age_s=connection.MAX_MESSAGE_AGE_S
    )
    kinds = [messages.Hello, *get_args(messages.Message)]
    listed = [kind for kind in get_args(arm_list.ArmListMessage) if kind not in kinds]
    own = [kind for kind in get_args(servo_bench.BenchMessage) if kind not in kinds]
    parts = [introduction, *map(_message, kinds), _LIST, *map(_message, listed)]
    parts += [_SERVOS, *map(_message, own)]
    return "\n\n".join(parts) + "\n"


def _message(model: type[BaseModel]) -> str:
    kinds = ", ".join(get_args(model.model_fields["kind"].annotation))
    own = [name for name in model.model_fields if name not in ("kind", "seq", "seen")]
    rows = [
        (
            code(name),
            describe_type(model.model_fields[name]),
            "yes" if model.model_fields[name].is_required() else "no",
        )
        for name in own
    ]
    text = (inspect.getdoc(model) or "").replace("``", "`").partition("\n\nAttributes:")
    parts = [f"### {kinds}", text[0], _attributes(text[2])]
    parts.append(table(["key", "type", "needed"], rows) if rows else "")
    return "\n\n".join(part for part in parts if part)


def _attributes(text: str) -> str:
    """Return the attributes of a docstring as a list."""
    items: list[str] = []
    for line in text.splitlines():
        name, colon, rest = line.strip().partition(": ")
        if line.startswith("    ") and not line.startswith("     ") and colon:
            items.append(f"- `{name}`: {rest}")
        elif line.strip() and items:
            items[-1] += f" {line.strip()}"
    return "\n".join(items)

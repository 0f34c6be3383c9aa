"""Remedies in the terms of each interface: commands, Python methods, buttons of the page.

Hints are written once, as a user at a terminal would type them; texts for programs and pages are
derived from them. A command without an equivalent, such as ``ikservo setup``, is kept.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

_PACKAGE = "ikservo"
_NEEDED_EXTRA = re.compile(r"needs the extra (\w+)")

_METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_NUMBER = r"-?(?:\d*\.)?\d+(?:m|cm|mm)?\b"


def _move_in_python(command: re.Match[str]) -> str:
    """Return the Python method for a command whose coordinates may have units."""
    found = re.findall(r"(-?[\d.]*\d)([a-z]*)", command[1])
    coordinates = (f"{float(number) * _METRES[unit]:.6g}" for number, unit in found)
    return f"arm.move_to(({', '.join(coordinates)}))"


_REPLACEMENTS = [
    (rf"ikservo move ({_NUMBER} {_NUMBER} {_NUMBER})", _move_in_python),
    (r"--think ([\d.]+)s", r"think_s=\1"),
    (" --pitch -90", " with stance=ToolOrientation(pitch_rad=-math.pi / 2)"),
    (r"ikservo (relax|where|stop)\b(?! [A-Z<])", r"arm.\1()"),
    (r"then: ikservo net acknowledge --port \S+", "then call arm.acknowledge()"),
    (r"acknowledge the stop\b", "call arm.acknowledge()"),
    (r"ikservo joints\b", "arm.move_joints()"),
    (r"ikservo pose (\w+)", r'arm.pose("\1")'),
    (r"--no-collision \(collisions=False\)", "--no-collision"),
    (r"--no-collision\b", "open_arm(..., collisions=False)"),
    (r"--uncalibrated\b", "open_arm(..., uncalibrated=True)"),
    (r"--overwrite\b", "overwrite=True"),
    (r"--foxglove-port (\d+)", r"foxglove_port=\1"),
    (r"without --line\b", "with arm.move_to()"),
    (r"--port (sim\b[^\s.,]*)", r'port="\1"'),
    (r"--port\b", "port="),
    (r", as in --arm (\w+)", r', as in open_arm("\1")'),
    (r"Give --arm\b", "Name it"),
    (r"--arm (\w+)", r'open_arm("\1")'),
    (r"to --arm\b", "to open_arm()"),
    (r"with --arm\b", "by the first argument of open_arm"),
    (r" \(--tip\)", ""),
]  # fmt: skip
_BUTTONS = [
    (r"ikservo relax\b(?! [A-Z<])", "acknowledge, then press Relax"),
    (r"See: ikservo where\b", "See Health on this page"),
    (r"ikservo where\b(?! [A-Z<])", "see Health on this page"),
    (r"ikservo calibrate\b(?!(?: \w+)? --)( \w+)?", "press Calibrate"),
    (r": ikservo doctor\b(?! --[rw])( --arm \w+)?", ": press Check in the list of arms"),
    (r": ikservo setup\b( ARM)?", ": press Set up servos in the list of arms"),
    (r": ikservo scan\b", ": press Find servos in the list of arms"),
    (r": (ikservo (?:recover|doctor --write-eeprom))\b", r", in a terminal: \1"),
]
_PAGE_REMEDIES = [(re.compile(pattern), replacement) for pattern, replacement in _BUTTONS]
_REMEDIES = [(re.compile(pattern), replacement) for pattern, replacement in _REPLACEMENTS]


def in_page(hint: str) -> str:
    """Rewrite a hint with the buttons of the page instead of commands."""
    return _replace(hint, _PAGE_REMEDIES)


def in_python(hint: str) -> str:
    """Rewrite a hint with methods and arguments instead of commands and their options."""
    return _replace(hint, _REMEDIES)


def install_command(extra: str = "") -> str:
    """Return the command that reinstalls this copy of ikservo with one more extra.

    The command names the source of this copy, because ``pip install ikservo`` cannot find an
    unpublished copy, and it uses the installer that made the environment.
    """
    receipt = Path(sys.prefix) / "uv-receipt.toml"
    extras = {extra} - {""}
    if receipt.is_file():  # a tool loses extras that are not named again
        needs: list[dict[str, Any]] = tomllib.loads(receipt.read_text("utf-8"))["tool"][
            "requirements"
        ]
        extras |= {name for own in needs if own["name"] == _PACKAGE
                   for name in own.get("extras", ())}  # fmt: skip
    source, is_editable = _source(f"[{','.join(sorted(extras))}]" if extras else "")
    editable = "--editable " if is_editable else ""
    if receipt.is_file():
        return f'uv tool install {"" if extra else "--reinstall "}{editable}"{source}"'
    if (Path(sys.prefix) / "pipx_metadata.json").is_file():
        return f'pipx install --force {editable}"{source}"'
    return f'{pip_command("install")} {editable}"{source}"'


def install_hint(message: str) -> str:
    """Return advice on installing the extra that a simulator's message names; empty if none."""
    needed = _NEEDED_EXTRA.search(message)
    return f"Install it: {install_command(needed[1])}" if needed else ""


def pip_command(verb: str) -> str:
    """Return the pip command for an action in the environment of this copy."""
    from importlib.util import find_spec  # noqa: PLC0415  # only a message needs it

    own = Path(sys.executable).parent
    found = shutil.which("pip")
    if found is not None and Path(found).parent == own:
        return f"pip {verb}"
    if find_spec("pip") is None:
        return f'uv pip {verb} --python "{sys.executable}"'
    return f'"{sys.executable}" -m pip {verb}'


def _source(extras: str) -> tuple[str, bool]:
    """Return the installer's source argument for this copy, and whether it is editable."""
    from importlib.metadata import PackageNotFoundError, distribution  # noqa: PLC0415  # as above
    from urllib.parse import urlsplit  # noqa: PLC0415
    from urllib.request import url2pathname  # noqa: PLC0415

    try:
        text = distribution(_PACKAGE).read_text("direct_url.json")
    except PackageNotFoundError:
        text = None
    if not text:
        return f"{_PACKAGE}{extras}", False
    origin: dict[str, Any] = json.loads(text)
    url = urlsplit(str(origin["url"]))
    if url.scheme == "file" and "vcs_info" not in origin:
        is_editable = origin.get("dir_info", {}).get("editable", False)
        return f"{url2pathname(url.path)}{extras}", is_editable
    control: dict[str, str] = origin.get("vcs_info", {})
    scheme = f"{control['vcs']}+" if control else ""
    revision = f"@{control['requested_revision']}" if "requested_revision" in control else ""
    return f"{_PACKAGE}{extras} @ {scheme}{origin['url']}{revision}", False


_Replacement = str | Callable[[re.Match[str]], str]


def _replace(hint: str, remedies: Sequence[tuple[re.Pattern[str], _Replacement]]) -> str:
    for pattern, replacement in remedies:
        hint = pattern.sub(replacement, hint)
    return hint

"""Expand xacro files to URDF in a separate Python process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from ikservo.apps.importing.packages import PackageFolders
from ikservo.errors import FileFormatError
from ikservo.model.urdf_xml import MAX_URDF_BYTES, XmlElement
from ikservo.remedies import install_command

_NAMESPACE = "xacro}"  # end of the namespace; its beginning varies
_HARMLESS = ("property", "arg")  # elements without effect unless an expression uses them


def needs_xacro(root: XmlElement) -> bool:
    """Check whether a description has macros or expressions that must be expanded."""
    waiting = [root]
    for element in waiting:
        own, _, name = element.tag.rpartition("}")
        if f"{own}}}".endswith(_NAMESPACE):
            if name not in _HARMLESS:
                return True
            continue
        if any("${" in text or "$(arg" in text for text in element.attributes.values()):
            return True
        waiting.extend(element.children)
    return False


_MISSING_ARGUMENT = re.compile(r"Undefined substitution argument ([A-Za-z0-9_]{1,64})")
_SHOWN_CHARS = 200
_MODULE = "xacro"
_MISSING, _UNKNOWN_PACKAGE = 97, 98  # exit codes of the child
_MAX_PACKAGES = 20
_TIMEOUT_S = 30.0
_MEMORY_BYTES = 1024 * 1024 * 1024
# The child sets its own limits, so that they never apply to this process.
_RUN = f"""
import sys
try:
    import resource
except ImportError:  # Windows has only the limit of time
    pass
else:
    for kind, most in (
        (resource.RLIMIT_AS, {_MEMORY_BYTES}), (resource.RLIMIT_FSIZE, {MAX_URDF_BYTES})
    ):
        _, hard = resource.getrlimit(kind)  # its user may have set a lower one
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))
import importlib, json, os, types
module, folders = sys.argv.pop(1), json.loads(sys.argv.pop(1))
try:
    xacro = importlib.import_module(module)
except ImportError:
    sys.exit({_MISSING})
def find(name):
    if name not in folders:
        print("\\n" + name, file=sys.stderr, flush=True)
        os._exit({_UNKNOWN_PACKAGE})  # xacro would catch an exception
    return folders[name]
packages = types.ModuleType("ament_index_python.packages")
packages.get_package_share_directory = find
sys.modules["ament_index_python"] = types.ModuleType("ament_index_python")
sys.modules["ament_index_python.packages"] = packages
xacro.main()
"""


def expand_xacro(
    path: Path, packages: PackageFolders | None = None, arguments: Mapping[str, str] | None = None
) -> str:
    """Return the URDF to which a xacro file expands; this runs Python expressions in the file.

    xacro runs in an isolated Python, which imports it from the installed packages and never from
    the current folder or ``PYTHONPATH``. ``packages`` finds the folders of ``$(find NAME)``;
    ``arguments`` are values of the file's ``<xacro:arg>`` by name.

    Raises:
        FileFormatError: xacro is not installed, does not accept the file, exceeds the limits on
            time, memory or output, or does not find a package; the message names the cause.
    """
    if not path.is_file():
        raise FileFormatError(path, "", "it does not exist", "a xacro file")
    packages = packages or PackageFolders(path)
    given = [f"{name}:={value}" for name, value in (arguments or {}).items()]
    code, text, error_output = _run_xacro(path, packages.used, given)
    for _ in range(_MAX_PACKAGES):
        if code != _UNKNOWN_PACKAGE:
            break
        packages.require(error_output.splitlines()[-1])
        code, text, error_output = _run_xacro(path, packages.used, given)
    if code == _MISSING:
        raise FileFormatError(
            path, "", "its macros need xacro, which is not installed",
            f"xacro ({install_command('import')}), or plain URDF",
        )  # fmt: skip
    missing = _MISSING_ARGUMENT.search(error_output) if code else None
    if missing:
        name = missing[1]
        expected = f"a value, given as --xacro-arg {name}:=VALUE"
        raise FileFormatError(path, "", f"its argument {name} has no value", expected)
    if code != 0 or len(text) >= MAX_URDF_BYTES:
        lines = error_output.strip().splitlines()
        last = [line for line in lines if not line.startswith("when processing file")][-1:]
        why = " ".join(error_output.split()) if len(error_output) <= _SHOWN_CHARS else "".join(last)
        found = f"xacro refuses it: {why[:_SHOWN_CHARS] or f'exit code {code}'}"
        raise FileFormatError(path, "", found, "a xacro file without errors")
    return text


def _run_xacro(
    path: Path, folders: Mapping[str, Path], arguments: list[str]
) -> tuple[int, str, str]:
    """Run xacro; return its exit code, output and error output."""
    known = json.dumps({name: str(folder.absolute()) for name, folder in folders.items()})
    command = [sys.executable, "-I", "-c", _RUN, _MODULE, known, str(path.absolute()), *arguments]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            code = subprocess.run(  # noqa: S603  # this Python, one file name
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=err,
                timeout=_TIMEOUT_S, check=False,
            ).returncode  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise FileFormatError(path, "", f"xacro failed ({error})", "a xacro file") from error
        return code, _read_start(out), _read_start(err)


def _read_start(file: BinaryIO) -> str:
    file.seek(0)
    return file.read(MAX_URDF_BYTES).decode("utf-8", "replace")

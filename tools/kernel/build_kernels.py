"""Build the extension module of the kernels: translate them to C, and compile that.

    python tools/kernel/build_kernels.py              # in place, where sources have changed
    python tools/kernel/build_kernels.py --sanitize   # with sanitizers and checked indices

Without a C compiler nothing is built and the kernels run as Python. With IKSERVO_COMPILED=1 that is
an error; with IKSERVO_COMPILED=0 nothing is built.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from translate import translate

__all__ = ["FOLDER", "BuildError", "build"]

ROOT = Path(__file__).parents[2]
FOLDER = Path("ikservo", "kernels")
"""Path of the module, in the tree and in the wheel."""

_NAME = "ikservo.kernels._compiled"
_SWITCH = "IKSERVO_COMPILED"
_MODULES = [
    "ikservo.kernels.search",
    "ikservo.kernels.single",
    "ikservo.kernels.tool_limits",
    "ikservo.kernels.capsule_distances",
    "ikservo.kernels.free_path",
    "ikservo.kernels.way_search",
]
# The C code computes as Python does: no fused products, no other order. Errors set no errno and no
# trap. A call of memset or memcpy for five numbers takes longer than a loop (clang warns that it
# lacks such a flag).
_UNIX = ["-O2", "-g0", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
_UNIX += ["-fno-tree-loop-distribute-patterns"]
_WINDOWS = ["/O2", "/fp:precise"]
_SANITIZE = ["-g", "-DCHECK_INDICES", "-fsanitize=address,undefined", "-fno-sanitize-recover"]


class BuildError(Exception):
    """The module cannot be built, but IKSERVO_COMPILED=1 requires it."""


@dataclass(frozen=True)
class _Plan:
    """Sources and options of one compilation."""

    kernels: Path
    flags: list[str]
    link_flags: list[str]
    build_id: str


def build(into: Path, *, sanitize: bool = False) -> Path | None:
    """Build the module below a folder, unless it was built there from the same sources and tools.

    Args:
        into: The folder that holds the package.
        sanitize: Whether the module checks every index, and stops on undefined behaviour.

    Returns:
        The module's path; None if there is no compiler, or it failed.

    Raises:
        BuildError: There is no compiler, or it failed, and IKSERVO_COMPILED=1.
        TranslationError: A kernel is not in the subset.
    """
    switch = os.environ.get(_SWITCH)
    # Python without the global lock cannot load modules of the limited API.
    limited = not sysconfig.get_config_var("Py_GIL_DISABLED")
    if switch == "0" or platform.python_implementation() != "CPython" or not limited:
        return None
    path = _compile(_write_kernels(sanitize=sanitize), into)
    if path is None and switch == "1":
        raise BuildError("The kernels were not compiled: no C compiler, or it failed (see above).")
    return path


def _write_kernels(*, sanitize: bool) -> _Plan:
    """Translate the kernels into one file beside the compiler's own."""
    code, sources, digests = translate(ROOT, [name for name in _MODULES if _exists(name)])
    unix = sys.platform != "win32"
    flags = (_UNIX if unix else _WINDOWS) + (_SANITIZE if sanitize else [])
    tools = (Path(__file__).parent / "extension.c").read_bytes() + " ".join(flags).encode()
    build_id = hashlib.sha256(code.encode() + tools + digests.encode()).hexdigest()
    names = " ".join(path.relative_to(ROOT).as_posix() for path in sources)
    kernels = ROOT / "build" / "kernel" / "kernels.c"
    kernels.parent.mkdir(parents=True, exist_ok=True)
    strings = {"SOURCES": names, "DIGESTS": digests, "BUILD_ID": build_id}
    lines = [f'#define {name} "{value}"' for name, value in strings.items()]
    kernels.write_text("\n".join([*lines, code]), encoding="utf-8")
    return _Plan(kernels, flags, (_SANITIZE if sanitize else []), build_id)


def _exists(module: str) -> bool:
    """Check whether a module exists, because its app may have been deleted."""
    return (ROOT / module.replace(".", "/")).with_suffix(".py").is_file()


def _compile(plan: _Plan, into: Path) -> Path | None:
    """Compile with the compiler that Python was built for; setuptools knows where that is."""
    import numpy as np  # noqa: PLC0415  # only where it is built
    from setuptools import Distribution, Extension  # noqa: PLC0415
    from setuptools.command.build_ext import build_ext  # noqa: PLC0415

    extension = Extension(
        _NAME,
        [(Path(__file__).parent / "extension.c").relative_to(ROOT).as_posix()],
        define_macros=[("Py_LIMITED_API", "0x030B0000")],
        include_dirs=[str(plan.kernels.parent), np.get_include()],
        extra_compile_args=plan.flags,
        extra_link_args=plan.link_flags,
        libraries=[] if sys.platform == "win32" else ["m"],
        py_limited_api=True,
        optional=True,
    )
    command = build_ext(Distribution({"ext_modules": [extension]}))
    command.build_lib, command.build_temp = str(into.resolve()), str(plan.kernels.parent)
    command.force = True
    command.ensure_finalized()
    path = Path(command.get_ext_fullpath(_NAME))
    if path.is_file() and plan.build_id.encode() in path.read_bytes():
        return path
    path.unlink(missing_ok=True)
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        command.run()
    finally:
        os.chdir(before)
    return path if path.is_file() else None


def main() -> None:
    """Build in place, and print how the kernels run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sanitize", action="store_true")
    given = parser.parse_args()
    path = build(ROOT, sanitize=given.sanitize)
    if path:
        print(f"kernels: compiled ({path.relative_to(ROOT)})")
    else:
        print("kernels: not compiled, the solver is slow; install a C compiler, then: make build")


if __name__ == "__main__":
    main()

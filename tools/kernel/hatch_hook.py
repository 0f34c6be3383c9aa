"""Hatchling's build hook: the wheel carries the compiled kernels if there is a compiler."""

from __future__ import annotations

import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parent))

from build_kernels import FOLDER, ROOT, build

__all__ = ["KernelBuildHook"]


class KernelBuildHook(BuildHookInterface[Any]):
    """Compiles the kernels into the wheel; for an editable installation into the tree."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the module to the wheel, and set the wheel's platform tag."""
        if version == "editable":
            build(ROOT)
            return
        self._folder = tempfile.TemporaryDirectory()
        path = build(Path(self._folder.name))
        if path is None:
            self.app.display_warning("The kernels are not compiled; the solver will be slow.")
            return
        build_data["force_include"][str(path)] = (FOLDER / path.name).as_posix()
        build_data["pure_python"] = False
        machine = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"cp311-abi3-{machine}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled for the wheel."""
        if version != "editable":
            self._folder.cleanup()

"""Run the kernels' tests on a module with checked indices and sanitizers (gcc or clang on Linux).

python tools/kernel/sanitize.py [ARGUMENT ...]      arguments go to pytest
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from build_kernels import ROOT, build

_COPY = ROOT / "build" / "sanitized"
_TESTS = [
    "tests/test_kernel_entries.py",
    "tests/ik/test_compiled.py",
    "tests/ik/test_bounded.py",
    "tests/guard/test_collision_kernel_compiled.py",
    "tests/guard/test_collision_kernel.py",
]


def main() -> int:
    """Build a copy of the package with such a module, and run the tests on it."""
    shutil.rmtree(_COPY, ignore_errors=True)
    shutil.copytree(ROOT / "ikservo", _COPY / "ikservo", ignore=shutil.ignore_patterns("*.so"))
    (_COPY / "configs").symlink_to(ROOT / "configs")
    os.environ["IKSERVO_COMPILED"] = "1"
    build(_COPY, sanitize=True)
    compiler = os.environ.get("CC", "gcc")
    library = subprocess.check_output([compiler, "-print-file-name=libasan.so"], text=True).strip()
    environment = os.environ | {
        "LD_PRELOAD": library,
        "ASAN_OPTIONS": "detect_leaks=0",  # Python does not free everything at its end
        "PYTHONPATH": os.pathsep.join([str(_COPY), str(ROOT / "sim"), str(ROOT)]),
    }
    command = [sys.executable, "-P", "-m", "pytest", "-n", "0", *(sys.argv[1:] or _TESTS)]
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())

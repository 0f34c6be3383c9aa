"""Which packages are mutated, and which tests have to notice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["PACKAGES", "ROOT", "Package"]

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Package:
    """A package of ``ikservo`` and its tests.

    Attributes:
        name: Its name below ``ikservo``.
        left_out: Parts of names of test files that are too long or no business of single modules.
        beyond: Test files of other packages that are asked where the package's own pass.
        kernel: A compiled module, which stays loaded while others are mutated and is mutated as
            plain Python with its own tests only.
    """

    name: str
    left_out: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()
    kernel: str = ""

    @property
    def folder(self) -> Path:
        """Return where its code is."""
        return ROOT / "ikservo" / self.name

    @property
    def modules(self) -> list[str]:
        """Return the names of its modules below the package."""
        files = (p for p in self.folder.rglob("*.py") if p.stem != "__init__")
        return sorted(".".join(p.relative_to(self.folder).with_suffix("").parts) for p in files)

    def path_of(self, module: str) -> Path:
        """Return the file of a module."""
        return self.folder.joinpath(*module.split(".")).with_suffix(".py")

    def tests_of(self, module: str) -> list[list[str]]:
        """Return rounds of test files: the module's own, the package's others, those beyond."""
        folder, stem = ROOT / "tests" / self.name, module.rpartition(".")[2]
        files = sorted(str(path) for path in folder.glob("test_*.py"))
        files = [f for f in files if not any(part in Path(f).name for part in self.left_out)]
        own = [f for f in files if stem in Path(f).name]
        if self.kernel and module == self.kernel:
            return [own]
        rest = [f for f in files if f not in own]
        rounds = [own, rest, [str(ROOT / "tests" / f) for f in self.beyond]]
        return [files for files in rounds if files]


PACKAGES = {
    package.name: package
    for package in (
        Package("guard", left_out=("promise",), kernel="nearness"),
        Package(
            "kinematics",
            beyond=("guard/test_space.py", "guard/test_nearness.py", "ik/test_kernel.py"),
        ),
        Package(
            "calibration", left_out=("hidden_arms",), beyond=("calibration/test_hidden_arms.py",)
        ),
    )
}

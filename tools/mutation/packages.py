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
        beyond: Test files of other packages that use this one too.
        kernel: A compiled module, which is mutated as plain Python with its own tests only.
        layouts: Modules whose constants are compiled into kernels: those run as plain Python
            where such a constant is changed.
    """

    name: str
    left_out: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()
    kernel: str = ""
    layouts: tuple[str, ...] = ()

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

    def tests(self) -> list[Path]:
        """Return all test files: the package's own, then those beyond."""
        files = sorted((ROOT / "tests" / self.name).glob("test_*.py"))
        kept = [f for f in files if not any(part in f.name for part in self.left_out)]
        return kept + [ROOT / "tests" / f for f in self.beyond]

    def is_own(self, module: str, test: Path) -> bool:
        """Return whether a test file is named after the module."""
        return module.rpartition(".")[2] in test.name

    def is_plain(self, module: str) -> bool:
        """Return whether kernels run as plain Python while the module is mutated."""
        return module == self.kernel or module in self.layouts


PACKAGES = {
    package.name: package
    for package in (
        Package(
            "guard",
            left_out=("promise",),
            beyond=("kinematics/test_gravity.py",),
            kernel="collision_kernel",
        ),
        Package(
            "kinematics",
            beyond=(
                "guard/test_collision_checker.py",
                "guard/test_collision_kernel.py",
                "ik/test_kernel.py",
            ),
            layouts=("packed",),
        ),
        Package("calibration", left_out=("mounted_arms",)),
    )
}

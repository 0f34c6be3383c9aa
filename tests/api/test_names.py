"""Everything a program needs is importable from ``ikservo`` itself."""

import ast
import importlib
from pathlib import Path

import pytest

import ikservo
from ikservo import errors

SOURCES = Path(ikservo.__file__).parent


def test_every_error_is_importable_from_the_top_level():
    found = [name for name in vars(errors) if name.endswith("Error")]
    assert len(found) >= 30
    for name in found:
        assert getattr(ikservo, name) is getattr(errors, name)
        assert name in ikservo.__all__


def test_every_name_in_top_level_all_exists():
    for name in ikservo.__all__:
        assert getattr(ikservo, name) is not None


def test_an_error_can_be_caught_by_its_top_level_name():
    with pytest.raises(ikservo.UnknownNameError):
        ikservo.load_model("so102")
    with (
        ikservo.open_arm("so101", port="sim") as arm,
        pytest.raises(ikservo.UnreachableError),
    ):
        arm.move_to((0.9, 0.0, 0.1))


def raised_in_the_packages_of_the_api():
    for path in sorted(SOURCES.rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ClassDef) and node.name.endswith("Error"):
                yield path, node.name, node.name.startswith("_") and f"except {node.name}" in text


@pytest.mark.full
def test_every_error_that_api_raises_is_at_top_level():
    own = ("cli/", "apps/page/")  # these have errors that no program ever sees
    missing = [
        f"{path.relative_to(SOURCES)}: {name}"
        for path, name, caught_here in raised_in_the_packages_of_the_api()
        if not caught_here
        and not path.relative_to(SOURCES).as_posix().startswith(own)
        and not hasattr(ikservo, name)
    ]
    assert missing == []


def test_package_dir_lists_lazily_imported_names():
    module = importlib.import_module("ikservo")
    assert set(module.__dir__()) >= {"open_arm", "UnreachableError"}

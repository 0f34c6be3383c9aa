"""The output of commands with --json agrees with docs/json.md."""

import ast
import dataclasses
import json
import re
from pathlib import Path

import pytest

import ikservo
from ikservo.apps.remote.fleet import FleetArm
from ikservo.apps.workbench.findings import Finding
from ikservo.arm import JointState
from ikservo.calibration.servo_config import RegisterMismatch
from ikservo.serving.control_client import StopResult

ROOT = Path(ikservo.__file__).parent
ROW = re.compile(r"^\| `(?P<schema>[a-z-]+)` \| .* \| (?P<keys>[^|]*) \|$")
KEY = re.compile(r"`(\w+)`(\??)")
SIM = "--arm so101 --port sim:?pose=home"

PRINTED_AS_THEY_ARE = {  # by key and schema
    ("joints", "where"): JointState,
    ("differences", "calibration-diff"): RegisterMismatch,
    ("checks", "doctor"): Finding,
    ("arms", "stop"): StopResult,
    ("arms", "fleet"): FleetArm,
}

PRINTERS = ("print_json", "print_fields", "print_records")
QUIET = [  # one command for each schema whose keys the sources put together while they run
    f"where {SIM} --json",
    f"where {SIM} --visible-from 0.6,0.3,0.4 --json",
    f"joints wrist_roll=5 {SIM} --json",
    f"move 0.2 0.05 0.15 --dry-run {SIM} --json",
    f"arc 0.2 0.05 0.12 --via 0.21,0.03,0.1 {SIM} --json",
    "solve 0.2 0.05 0.15 --arm so101 --json",
    "solve 0.2 0.05 0.15 --arm so101 --force 0 0 -1 --json",
    "solve 0.25 0.05 0.15 --arm px100 --all --json",
    "workspace 0.2 0.05 0.15 --arm so101 --json",
    "move 9 9 9 --arm nowhere --json",
]


def documented():
    """Return the required and the optional keys, by schema."""
    table = (ROOT.parent / "docs" / "json.md").read_text().partition("Objects inside")[0]
    rows = [found for line in table.splitlines() if (found := ROW.match(line))]
    keys = {row["schema"]: KEY.findall(row["keys"]) for row in rows}
    return {
        schema: ({key for key, mark in pairs if not mark}, {key for key, mark in pairs if mark})
        for schema, pairs in keys.items()
    }


def printed():
    """Yield the schema and the keys of each JSON object that the sources print."""
    for path in sorted([*(ROOT / "cli").rglob("*.py"), *(ROOT / "apps").rglob("*.py")]):
        module = ast.parse(path.read_text())
        for node in ast.walk(module):
            name = getattr(getattr(node, "func", None), "id", "")
            if name not in PRINTERS or path.name == "results.py":
                continue
            keys = {keyword.arg for keyword in node.keywords} - {"json", "order", "width"}
            if name == "print_records":
                keys.add(node.args[1].value)
            if name == "print_fields":
                keys |= field_keys(module, ast.unparse(node.args[2]).partition("(")[0])
            yield node.args[0].value, keys


def field_keys(module, table):
    """Return the keys of a table of fields, given as a constant, a function or a variable."""
    for node in ast.walk(module):
        named = getattr(node, "name", "") or getattr(getattr(node, "target", None), "id", "")
        if named == table:
            calls = [each for each in ast.walk(node) if getattr(each, "func", None)]
            return {each.args[0].value for each in calls if ast.unparse(each.func) == "Field"}
    raise LookupError(table)


def test_every_json_schema_is_documented():
    assert set(documented()) == {schema for schema, _ in printed()} | {"error"}


@pytest.mark.parametrize(("schema", "keys"), [each for each in printed() if None not in each[1]])
def test_json_keys_in_sources_match_the_documentation(schema, keys):
    always, maybe = documented()[schema]
    assert always <= keys <= always | maybe


@pytest.mark.full
@pytest.mark.parametrize("words", QUIET)
def test_printed_json_keys_match_the_documentation(run_cli, words):
    result = run_cli(words)
    answer = json.loads(result.out)
    always, maybe = documented()[answer.pop("schema").split("/")[1]]
    assert always <= set(answer) <= always | maybe


@pytest.mark.parametrize(("place", "kind"), PRINTED_AS_THEY_ARE.items())
def test_documented_json_fields_match_their_dataclasses(place, kind):
    key, schema = place
    (row,) = [
        line
        for line in (ROOT.parent / "docs" / "json.md").read_text().splitlines()
        if line.startswith(f"| `{key}` | `{schema}` |")
    ]
    names = re.findall(r"`(\w+)`", row.split("|")[3])
    assert names == [field.name for field in dataclasses.fields(kind)]

"""Health limits in an arm file, and their defaults."""

import math

import pytest

from ikservo.errors import FileFormatError
from ikservo.model import load_model
from ikservo.model.arm_file import read_arm_file
from tests.oracle import CONFIGS

SO101 = CONFIGS / "so101" / "arm.toml"


def arm_with(tmp_path, table):
    path = tmp_path / "arm.toml"
    path.write_text(f"{SO101.read_text()}\n[health]\n{table}\n")
    (tmp_path / "arm.urdf").write_text((CONFIGS / "so101" / "arm.urdf").read_text())
    return path


def test_health_limits_have_defaults_without_table():
    health = load_model(SO101).health
    assert (health.warn_c, health.hold_c, health.release_c) == (60.0, 65.0, 70.0)
    assert (health.load_percent, health.load_s) == (90.0, 3.0)
    assert (health.low_v, health.high_v) == (0.0, math.inf)


def test_health_table_replaces_default_limits(tmp_path):
    health = load_model(arm_with(tmp_path, "hold_c = 62.0\nhigh_v = 8.0")).health
    assert (health.warn_c, health.hold_c, health.low_v, health.high_v) == (60.0, 62.0, 0.0, 8.0)


@pytest.mark.parametrize(
    ("table", "where"),
    [
        ("hold_c = 59.0", "health.hold_c"),
        ("release_c = 64.0", "health.release_c"),
        ("warn_c = -1.0", "health.warn_c"),
        ("load_s = nan", "health.load_s"),
        ("low_v = 8.0\nhigh_v = 8.0", "health.low_v"),
        ("low_v = 0", "health.low_v"),
        ("cold_c = 5.0", "health.cold_c"),
    ],
)
def test_inconsistent_health_table_is_refused_with_its_key(tmp_path, table, where):
    with pytest.raises(FileFormatError) as caught:
        read_arm_file(arm_with(tmp_path, table))
    assert caught.value.where == where

"""Missing requirements of an installation are reported before it begins."""

import pytest

from tools.check_machine import missing_text

ADVICE = "sudo apt install g++ python3-dev"


@pytest.fixture
def headers(tmp_path):
    (tmp_path / "Python.h").touch()
    return tmp_path


@pytest.mark.parametrize("machine", ["Linux aarch64", "Linux armv7l"])
def test_machine_check_on_pi_names_missing_compiler_packages(machine, headers):
    assert missing_text(machine, None, headers).endswith(ADVICE)


def test_machine_check_on_pi_names_missing_header_packages(tmp_path):
    assert missing_text("Linux aarch64", "/usr/bin/c++", tmp_path).endswith(ADVICE)


def test_machine_check_passes_on_pi_with_compiler_and_headers(headers):
    assert missing_text("Linux aarch64", "/usr/bin/c++", headers) == ""


@pytest.mark.parametrize("machine", ["Linux x86_64", "Darwin arm64", "Windows ARM64"])
def test_machine_check_with_wheel_needs_no_compiler(machine, tmp_path):
    assert missing_text(machine, None, tmp_path) == ""

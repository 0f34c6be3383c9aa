"""Missing requirements of an installation are reported before it begins."""

import pytest

from tools.check_machine import missing_text

ADVICE = "sudo apt install g++ python3-dev"


@pytest.fixture
def headers(tmp_path):
    (tmp_path / "Python.h").touch()
    return tmp_path


@pytest.mark.parametrize("machine", ["Linux aarch64", "Linux armv7l"])
def test_raspberry_pi_without_compiler_names_packages(machine, headers):
    assert missing_text(machine, None, headers).endswith(ADVICE)


def test_raspberry_pi_without_headers_names_packages(tmp_path):
    assert missing_text("Linux aarch64", "/usr/bin/c++", tmp_path).endswith(ADVICE)


def test_raspberry_pi_with_compiler_and_headers_misses_nothing(headers):
    assert missing_text("Linux aarch64", "/usr/bin/c++", headers) == ""


@pytest.mark.parametrize("machine", ["Linux x86_64", "Darwin arm64", "Windows ARM64"])
def test_machine_with_wheel_does_not_need_compiler(machine, tmp_path):
    assert missing_text(machine, None, tmp_path) == ""

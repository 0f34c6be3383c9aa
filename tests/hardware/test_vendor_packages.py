"""The vendors' modules as installed by any of the packages on PyPI that contain them.

pip overwrites the files of a package with the same module, and uninstalling one of two removes the
files of both.
"""

import os
import shutil
import subprocess
import sys

import pytest

UNREACHABLE = ("Temporary failure in name resolution", "NewConnectionError", "timed out")
MOVES = {"so101": "move 0.25 0.05 0.15", "koch": "move 0.2 0.05 0.15"}
FEETECH, FTSERVO = "feetech-servo-sdk==1.0.0", "ftservo-python-sdk==2.0.1"
NEWEST_DYNAMIXEL = "dynamixel-sdk==4.1.0"


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """Return a function that unpacks a package from the registry, once."""
    folders = {}

    def unpack(package):
        if package not in folders:
            folder = tmp_path_factory.mktemp("package")
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--retries=1"]
            command = [*pip, "--target", folder, package]
            run = subprocess.run(command, check=False, capture_output=True, text=True, timeout=100)
            if run.returncode and any(reason in run.stderr for reason in UNREACHABLE):
                pytest.skip("the package registry cannot be reached")
            assert run.returncode == 0, run.stderr
            folders[package] = folder
        return folders[package]

    return unpack


@pytest.fixture
def installed(unpacked, tmp_path):
    """Return a function that installs packages over each other, in order."""

    def install(*packages):
        for package in packages:
            shutil.copytree(unpacked(package), tmp_path, dirs_exist_ok=True)
        return tmp_path

    return install


def run(folder, command):
    words = [sys.executable, "-m", "ikservo", *command.split()]
    environment = os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(words, env=environment, check=False, capture_output=True, text=True,
                          timeout=100)  # fmt: skip


def moved(folder, arm):
    return run(folder, f"{MOVES[arm]} --arm {arm} --port sim --yes")


@pytest.mark.full
@pytest.mark.parametrize("packages", [(FEETECH, FTSERVO), (FTSERVO, FEETECH)])
def test_feetech_arm_moves_with_both_sdk_packages_installed(installed, packages):
    result = moved(installed(*packages), "so101")
    assert result.returncode == 0, result.stderr


@pytest.mark.full
@pytest.mark.parametrize("package", ["ftservo-python-sdk==2.0.0", FTSERVO])
def test_doctor_command_works_with_renamed_feetech_sdk(installed, package):
    result = run(installed(package), "doctor --arm so101 --port sim")
    assert result.returncode == 0, result.stderr


@pytest.mark.campaign
@pytest.mark.parametrize("release", ["3.7.31", "3.8.4", "4.0.5"])
def test_dynamixel_arm_moves_with_old_sdk_installed_over_new(installed, release):
    result = moved(installed(NEWEST_DYNAMIXEL, f"dynamixel-sdk=={release}"), "koch")
    assert result.returncode == 0, result.stderr


@pytest.mark.full
def test_error_names_pip_package_serial_that_hides_pyserial(installed):
    result = run(installed("pyserial==3.5", "serial==0.0.97"), "ports")
    first, second = result.stderr.splitlines()
    assert first == "The Python module serial of pyserial is damaged or was replaced by serial."
    assert "pip uninstall --yes serial && " in second
    assert second.endswith("pip install --force-reinstall pyserial")


@pytest.mark.full
def test_pyserial_works_if_installed_after_package_serial(installed):
    result = moved(installed("serial==0.0.97", "pyserial==3.5"), "so101")
    assert result.returncode == 0, result.stderr


@pytest.mark.full
@pytest.mark.parametrize(("package", "module", "arm"),
                         [(FEETECH, "scservo_sdk", "so101"),
                          (NEWEST_DYNAMIXEL, "dynamixel_sdk", "koch"),
                          ("pyserial==3.5", "serial", "so101")])  # fmt: skip
def test_error_names_damaged_vendor_module_and_repair(installed, package, module, arm):
    folder = installed(package)
    for path in (folder / module).glob("p*.py"):  # packets, ports: what the packages share
        path.unlink()
    (folder / module / "__init__.py").write_text("")
    shutil.rmtree(folder / module / "tools", ignore_errors=True)
    result = moved(folder, arm)
    first, second = result.stderr.splitlines()
    assert first.startswith(f"The Python module {module} of ")
    assert second.endswith(f"pip install --force-reinstall {package.partition('==')[0]}")

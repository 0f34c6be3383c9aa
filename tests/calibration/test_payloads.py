"""Two hundred hostile names: every file stays in the user's own folder."""

from itertools import product

import pytest

from ikservo.calibration.paths import calibration_path, confirmation_path, journal_path

# fmt: off
STEPS = ["..", "../..", "..\\..", "/", "//", "\\\\host\\share", "C:\\", "~", "~root", "%2e%2e%2f",
         "..%2f", "․․/", "．．／", "..;/", "....//", "./.", "file:///", "\0", "\n", "$HOME"]
ENDS = ["etc/passwd", "etc\\passwd", "x", "x.toml", ".bashrc", "con", "a" * 300, "\u202etxt", "é/ü",
        ""]
# fmt: on
PAYLOADS = [step + end for step, end in product(STEPS, ENDS)]


@pytest.mark.parametrize("place", [calibration_path, journal_path, confirmation_path])
def test_malicious_arm_or_adapter_name_cannot_leave_folder(place, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    assert len(PAYLOADS) == 200
    for payload in PAYLOADS:
        for path in (place(payload, ""), place("so101", payload), place(payload, payload)):
            assert path.parent.parent == tmp_path
            assert path.resolve().is_relative_to(tmp_path.resolve())
            assert len(path.name) < 200

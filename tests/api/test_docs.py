"""Every public method of an arm has a useful docstring."""

import ikservo


def test_every_public_method_of_an_arm_has_a_docstring():
    bare = [
        name
        for name in dir(ikservo.Arm)
        if not name.startswith("_") and not (getattr(ikservo.Arm, name).__doc__ or "").strip()
    ]
    assert bare == []

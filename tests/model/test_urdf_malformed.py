"""Every error in a URDF is refused with its file, its line and the expected value."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from pathlib import Path

import pytest

from ikservo.errors import FileFormatError
from ikservo.model.model_loading import read_description
from ikservo.model.urdf import read_urdf


def refused(path: Path, content: bytes) -> FileFormatError:
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_urdf(path)
    return caught.value


# fmt: off
SLIPS = {
    "floating joint":        ('type="continuous"', 'type="floating"',
                              "line 23", 'joint "roll" is of type "floating"', "one of fixed, revolute, continuous, prismatic"),
    "planar joint":          ('type="continuous"', 'type="planar"',
                              "line 23", 'joint "roll" is of type "planar"', "one of fixed, revolute, continuous, prismatic"),
    "misspelled type":       ('name="roll" type="continuous"', 'name="roll" type="Revolute"',
                              "line 23", 'joint "roll" is of type "Revolute"', "one of fixed, revolute, continuous, prismatic"),
    "no type":               ('name="roll" type="continuous"', 'name="roll"',
                              "line 23", "<joint> has no type", 'type="…"'),
    "joint without name":    ('name="roll" type', "type",
                              "line 23", "<joint> has no name", 'name="…"'),
    "empty name":            ('name="roll"', 'name=" "',
                              "line 23", '<joint> has name=" "', "1 to 128 printable characters"),
    "escape in a name":      ('name="roll"', 'name="\x9b31m"',
                              "line 23", "<joint> has name='\\x9b31m'", "1 to 128 printable characters"),
    "endless name":          ('name="roll"', f'name="{"r" * 129}"',
                              "line 23", f'<joint> has name="{"r" * 59}…"', "1 to 128 printable characters"),
    "no parent":             ('<parent link="fore"/>', "",
                              "line 23", "<joint> has no <parent>", "<parent …/> inside it"),
    "no child":              ('<child link="wrist"/>', "",
                              "line 23", "<joint> has no <child>", "<child …/> inside it"),
    "two children":          ('<child link="wrist"/>', '<child link="wrist"/><child link="tip"/>',
                              "line 25", "is a second <child> in <joint>", "at most one"),
    "parent without link":   ('<parent link="fore"/>', '<parent name="fore"/>',
                              "line 24", "<parent> has no link", 'link="…"'),
    "unknown parent":        ('<parent link="fore"/>', '<parent link="for"/>',
                              "line 23", 'joint "roll" has the parent "for", which is not a link', 'the name of a <link>, perhaps "fore"'),
    "unknown child":         ('<child link="wrist"/>', '<child link="qqqqq"/>',
                              "line 23", 'joint "roll" has the child "qqqqq", which is not a link', "the name of a <link>"),
    "two links of one name": ('<link name="thumb"/>', '<link name="base"/>',
                              "line 58", 'link "base" is already defined in line 40', "each name once"),
    "two joints of one name": ('name="roll"', 'name="elbow"',
                              "line 23", 'joint "elbow" is already defined in line 10', "each name once"),
    "two parents":           ('<child link="thumb"/>', '<child link="finger"/>',
                              "line 33", 'joint "other_finger" has the child "finger", which is already the child of "gripper" in line 27', "one parent for each link"),
    "ring":                  ('<parent link="base"/>', '<parent link="wrist"/>',
                              "line 23", 'joint "roll" closes a cycle of links', "a tree without cycles"),
    "link on itself":        ('<parent link="fore"/>', '<parent link="wrist"/>',
                              "line 23", 'joint "roll" closes a cycle of links', "a tree without cycles"),
    "several roots":         ('<link name="thumb"/>', '<link name="thumb"/><link name="stray"/>',
                              "line 58", 'neither link "base" nor "stray" is the child of a joint', "exactly one root link"),
    "axis of zero length":   ('xyz="0 3 4"', 'xyz="0 0 0"',
                              "line 14", 'joint "elbow" moves about an axis of zero length', 'a direction, such as xyz="0 0 1"'),
    "axis without xyz":      ('<axis xyz="0 3 4"/>', "<axis/>",
                              "line 14", "<axis> has no xyz", 'xyz="…"'),
    "two numbers":           ('xyz="0 3 4"', 'xyz="0 3"',
                              "line 14", '<axis> has xyz="0 3"', "three finite numbers"),
    "four numbers":          ('xyz="0 3 4"', 'xyz="0 3 4 5"',
                              "line 14", '<axis> has xyz="0 3 4 5"', "three finite numbers"),
    "no numbers":            ('xyz="0.2 0 0"', 'xyz=""',
                              "line 13", '<origin> has xyz=""', "three finite numbers"),
    "comma":                 ('xyz="0.2 0 0"', 'xyz="0,2 0 0"',
                              "line 13", '<origin> has xyz="0,2 0 0"', "three finite numbers"),
    "not a number":          ('xyz="0.2 0 0"', 'xyz="nan 0 0"',
                              "line 13", '<origin> has xyz="nan 0 0"', "three finite numbers"),
    "infinite":              ('upper="2.5"', 'upper="inf"',
                              "line 15", '<limit> has upper="inf"', "one finite number"),
    "beyond all floats":     ('upper="2.5"', 'upper="1e999"',
                              "line 15", '<limit> has upper="1e999"', "one finite number"),
    "Python's underscore":   ('upper="2.5"', 'upper="1_0"',
                              "line 15", '<limit> has upper="1_0"', "one finite number"),
    "digits of other scripts": ('upper="2.5"', 'upper="٣"',
                              "line 15", '<limit> has upper="٣"', "one finite number"),
    "lower above upper":     ('lower="-1.5"', 'lower="3"',
                              "line 15", 'joint "elbow" has lower 3 above upper 2.5', "lower below upper"),
    "placeholder limits":    ('lower="-1.5" upper="2.5"', 'lower="0" upper="0"',
                              "line 15", 'joint "elbow" has lower = upper = 0, so it cannot move', 'its real range, or type="fixed"'),
    "limits left out":       ('lower="-1.5" upper="2.5" ', "",
                              "line 15", 'joint "elbow" has lower = upper = 0, so it cannot move', 'its real range, or type="fixed"'),
    "revolute without limit": ('<limit lower="-1.5" upper="2.5" effort="1.9" velocity="4"/>', "",
                              "line 10", "<joint> has no <limit>", "<limit …/> inside it"),
    "prismatic without limit": ('<limit lower="0" upper="0.02" effort="5" velocity="0.1"/>', "",
                              "line 27", "<joint> has no <limit>", "<limit …/> inside it"),
    "mimics nobody":         ('joint="gripper"', 'joint="grip"',
                              "line 33", 'joint "other_finger" mimics "grip", which cannot be mimicked', "a joint that moves and mimics no other"),
    "mimics itself":         ('joint="gripper"', 'joint="other_finger"',
                              "line 33", 'joint "other_finger" mimics "other_finger", which cannot be mimicked', "a joint that moves and mimics no other"),
    "mimics a fixed joint":  ('joint="gripper"', 'joint="tool"',
                              "line 33", 'joint "other_finger" mimics "tool", which cannot be mimicked', "a joint that moves and mimics no other"),
    "inertial without mass": ('<mass value="0.5"/>', "",
                              "line 41", "<inertial> has no <mass>", "<mass …/> inside it"),
    "negative inertia":      ('ixx="1e-3"', 'ixx="-1"',
                              "line 44", "an inertia of -1 kg m²", "ixx, iyy and izz of zero or more"),
    "huge inertia":          ('ixx="1e-3"', 'ixx="1e300"',
                              "line 44", '<inertia> has ixx="1e300"', "numbers within ±1e+06"),
    "huge limits":           ('upper="2.5"', 'upper="1e300"',
                              "line 15", '<limit> has upper="1e300"', "numbers within ±1e+06"),
    "negative mass":         ('value="0.5"', 'value="-0.5"',
                              "line 43", "a mass of -0.5 kg", "zero or more"),
    "flat box":              ('size="0.1 0.2 0.3"', 'size="0.1 0 0.3"',
                              "line 47", '<box> has size="0.1 0 0.3"', "more than zero metres"),
    "sphere without radius": ('<sphere radius="0.03"/>', "<sphere/>",
                              "line 55", "<sphere> has no radius", 'radius="…"'),
    "negative radius":       ('<sphere radius="0.03"/>', '<sphere radius="-1"/>',
                              "line 55", '<sphere> has radius="-1"', "more than zero metres"),
    "no shape":              ('<sphere radius="0.03"/>', "",
                              "line 55", "<geometry> holds nothing", "one of box, cylinder, sphere, mesh"),
    "unknown shape":         ('<sphere radius="0.03"/>', "<torus/>",
                              "line 55", "<geometry> holds <torus>", "one of box, cylinder, sphere, mesh"),
    "two shapes":            ('<sphere radius="0.03"/>', '<sphere radius="1"/><sphere radius="1"/>',
                              "line 55", "<geometry> holds <sphere>, <sphere>", "one of box, cylinder, sphere, mesh"),
    "no geometry":           ('<geometry><sphere radius="0.03"/></geometry>', "",
                              "line 55", "<collision> has no <geometry>", "<geometry …/> inside it"),
    "other root":            ('<robot name="small">', '<robot name="small"><sdf>',
                              "line 61", "XML syntax error: mismatched tag", "well-formed XML"),
    "undefined entity":      ('name="small"', 'name="&secret;"',
                              "line 2", "XML syntax error: undefined entity", "well-formed XML"),
    "attribute twice":       ('name="small"', 'name="small" name="big"',
                              "line 2", "XML syntax error: duplicate attribute", "well-formed XML"),
    "macro in a number":     ('xyz="0.2 0 0"', 'xyz="${length} 0 0"',
                              "line 13", '<origin> has xyz="${length} 0 0"', "plain numbers; convert it once: ikservo arms new NAME --from PATH"),
    "unexpanded macro":      ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="/etc/passwd"/></robot><robot ',
                              "line 2", "XML syntax error: junk after document element", "well-formed XML"),
}
# fmt: on


@pytest.mark.parametrize(("old", "new", "where", "found", "expected"), SLIPS.values(), ids=SLIPS)
def test_urdf_error_names_line_and_expected_value(
    urdf_path: Path, urdf_text: str, old: str, new: str, where: str, found: str, expected: str
) -> None:
    assert old in urdf_text
    error = refused(urdf_path, urdf_text.replace(old, new, 1).encode())
    expected = expected.replace("PATH", str(urdf_path))
    assert (error.where, error.found, error.expected) == (where, found, expected)


LAUGHS = b"""<?xml version="1.0"?>
<!DOCTYPE robot [
  <!ENTITY a "ha">
  <!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
  <!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">
]>
<robot name="&c;"/>
"""
EXTERNAL = b'<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>'
PARAMETER = b'<!DOCTYPE robot [<!ENTITY % x SYSTEM "http://127.0.0.1/x"> %x;]><robot/>'
REMOTE_DTD = b'<!DOCTYPE robot SYSTEM "http://127.0.0.1/robot.dtd"><robot/>'
DOCTYPE = "declares a document type (DTD)"

# fmt: off
DOCUMENTS = {
    "billion laughs":    (LAUGHS, "line 2", DOCTYPE),
    "external entity":   (EXTERNAL, "line 1", DOCTYPE),
    "parameter entity":  (PARAMETER, "line 1", DOCTYPE),
    "remote DTD":        (REMOTE_DTD, "line 1", DOCTYPE),
    "too deep":          (b"<robot>\n" + b"<a>" * 64, "line 2", "elements are nested too deeply"),
    "too many":          (b"<robot>\n" + b"<a/>" * 50_000 + b"</robot>", "line 2", "too many elements"),
    "truncated":         (b"<robot>\n<link name='a'/>\n<link ", "line 3", "XML syntax error: unclosed token"),
    "cut between tags":  (b"<robot>\n<link name='a'/>\n", "line 3", "XML syntax error: no element found"),
    "not XML":           (b"solid arm\nfacet normal 0 0 1\n", "line 1", "XML syntax error: syntax error"),
    "only a declaration": (b"<?xml version='1.0'?>\n", "line 2", "XML syntax error: no element found"),
    "latin-1":           (b"<robot>\n<!-- \xe9t\xe9 -->\n</robot>", "line 2", "holds the byte 0xE9, which is not UTF-8"),
    "UTF-16":            ("<robot/>".encode("utf-16"), "line 1", "holds the byte 0xFF, which is not UTF-8"),
    "null byte":         (b"<robot>\n\0</robot>", "line 2", "XML syntax error: not well-formed (invalid token)"),
    "empty":             (b"", "", "is empty"),
    "blank":             (b" \n\n", "", "is empty"),
    "too large":         (b"<robot>" + b" " * 4 * 1024 * 1024 + b"</robot>", "", "is too large"),
    "other format":      (b"<?xml version='1.0'?>\n<sdf version='1.6'/>", "line 2", "the outermost element is <sdf>"),
    "no links":          (b"<robot name='a'/>", "", "the robot has no links"),
    "xacro of ros.org":  (b'<robot xmlns:xacro="http://ros.org/wiki/xacro">\n<xacro:macro name="a"/></robot>',
                          "line 2", "the macros are not expanded"),
    "unexpanded xacro":  (b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">\n<xacro:include filename="/etc/passwd"/></robot>',
                          "line 2", "the macros are not expanded"),
}
# fmt: on


@pytest.mark.parametrize(("content", "where", "found"), DOCUMENTS.values(), ids=DOCUMENTS)
def test_invalid_document_is_refused(
    urdf_path: Path, content: bytes, where: str, found: str
) -> None:
    error = refused(urdf_path, content)
    assert (error.where, error.found) == (where, found)


def test_urdf_with_63_nested_levels_is_read(urdf_path: Path) -> None:
    inner = "<a>" * 63 + "</a>" * 63
    urdf_path.write_text(f'<robot><link name="only"/>{inner}</robot>')
    assert read_urdf(urdf_path).root == "only"


def test_unknown_xml_encoding_declared_by_urdf_is_ignored(urdf_path: Path) -> None:
    urdf_path.write_text('<?xml version="1.0" encoding="rot13"?><robot><link name="a"/></robot>')
    assert read_urdf(urdf_path).root == "a"


def test_urdf_error_text_names_file_line_and_expected_content(urdf_path: Path) -> None:
    error = refused(urdf_path, LAUGHS)
    assert str(error) == (
        f"{urdf_path}, line 2: {DOCTYPE}.\nExpected plain XML without <!DOCTYPE> and <!ENTITY>."
    )


def test_urdf_with_more_than_200_links_is_refused(urdf_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(201))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(200)
    )
    urdf_path.write_text(f"<robot>{links}{joints}</robot>")
    with pytest.raises(FileFormatError, match=r"has 201 links"):
        read_description(urdf_path)


def test_urdf_with_101_moving_joints_is_refused(urdf_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(102))
    joints = "".join(
        f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(101)
    )
    urdf_path.write_text(f"<robot>{links}{joints}</robot>")
    with pytest.raises(FileFormatError, match=r"has 101 joints that move"):
        read_description(urdf_path)

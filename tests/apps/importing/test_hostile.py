"""Hostile descriptions are refused, bounded, or read for what they are."""

import cProfile
import itertools
import os
from pathlib import Path

import pytest

import ikservo.cli
from ikservo.apps.importing.building import ImportOptions, build_drafts
from ikservo.apps.importing.description_sources import choose_description, read_foreign
from ikservo.apps.importing.folder import load_draft
from ikservo.apps.importing.tree import find_structures
from ikservo.errors import FileFormatError, IkservoError, InputError
from ikservo.model.urdf import urdf_from_xml
from ikservo.model.urdf_xml import parse_xml

JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
{more}</joint>"""


def joint(name, parent, child, kind="revolute", more=""):
    return JOINT.format(**locals())


def robot(*parts, head=""):
    return f"{head}<robot name='r'>{''.join(parts)}</robot>"


LINKS = "".join(f"<link name='{name}'/>" for name in "abcd")
CHAIN = joint("j1", "a", "b") + joint("j2", "b", "c") + joint("j3", "c", "d")


@pytest.fixture
def read(tmp_path):
    def run(text, name="arm.urdf", *, allow_xacro=False):
        path = tmp_path / name
        path.write_text(text)
        description = read_foreign(path, {}, {}, allow_xacro=allow_xacro)
        steps = build_drafts(description, "mine", ImportOptions())
        while True:
            try:
                next(steps)
            except StopIteration as end:
                return end.value[0]

    return run


BOMB = "<!DOCTYPE r [<!ENTITY a 'x'>" + "".join(
    f"<!ENTITY {b} '{f'&{a};' * 20}'>" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
) + "]>"  # fmt: skip


@pytest.mark.parametrize("name", ["arm.urdf", "arm.urdf.xacro"])
@pytest.mark.parametrize("head", [BOMB, "<!DOCTYPE r SYSTEM 'file:///etc/passwd'>"])
def test_description_with_xml_doctype_is_refused(read, head, name):
    with pytest.raises(FileFormatError, match="document type"):
        read(robot(LINKS, CHAIN, head=head), name, allow_xacro=True)


def test_urdf_with_cycle_of_links_is_refused(read):
    with pytest.raises(FileFormatError, match=r"cycle|child"):
        read(robot(LINKS, CHAIN, joint("j4", "d", "a")))


def test_mutual_mimic_joints_are_imported_as_independent(read):
    follows = "<mimic joint='{}'/>"
    draft = read(robot(
        LINKS, joint("j1", "a", "b", more=follows.format("j2")),
        joint("j2", "b", "c", more=follows.format("j1")), joint("j3", "c", "d"),
    ))  # fmt: skip
    assert any("follows no moving joint" in each for each in draft.dropped)
    load_with_zero(draft)


def load_with_zero(draft):
    zero = {each.name: 0.0 for each in draft.joints}
    draft.poses = {"rest": zero, "home": zero}
    return load_draft(draft)


@pytest.mark.parametrize(
    "name", ['x"] = 1', "[bus]", "a'b", "#", "é ü", "</robot>".replace("<", "&lt;")]
)
def test_hostile_link_names_are_escaped_in_written_files(read, name):
    quoted = name.replace("'", "&apos;")
    draft = read(robot(LINKS.replace("'d'", f"'{quoted}'"), CHAIN.replace('"d"', f'"{quoted}"')
                       if '"' not in name else CHAIN.replace('"d"', f"'{quoted}'")))  # fmt: skip
    model = load_with_zero(draft)
    assert model.chain.tip == name.replace("&lt;", "<")


def test_description_of_100_joints_gives_a_loadable_arm(read):
    names = [f"n{i}" for i in range(101)]
    links = "".join(f"<link name='{name}'/>" for name in names)
    chain = "".join(joint(f"k{b}", a, b) for a, b in itertools.pairwise(names))
    assert load_with_zero(read(robot(links, chain))).chain.dof == 100


@pytest.mark.parametrize(
    "text",
    [
        robot(LINKS, *(f"<link name='l{i}'/>" for i in range(1001)),
              *(joint(f"k{i}", "d", f"l{i}", "fixed") for i in range(1001)), CHAIN),
        robot(*["<link name='a'>"] * 70),
        robot("<link name='a'/>" * 60_000),
        robot(LINKS, CHAIN.replace('xyz="0 0 0.1"', 'xyz="1e300 0 0"')),
        robot(LINKS, CHAIN.replace('xyz="0 1 0"', 'xyz="nan 0 0"')),
        robot(LINKS, CHAIN.replace('lower="-1"', 'lower="2"')),
        "<sdf/>",
        "",
        "\0",
    ],
    ids=["links", "depth", "elements", "far", "nan", "limits", "other", "empty", "null"],
)  # fmt: skip
def test_invalid_description_gives_one_sentence_error(read, text):
    with pytest.raises(IkservoError) as caught:
        read(text)
    assert len(str(caught.value)) < 500


def test_import_report_names_unread_mesh_outside_folder(read):
    shape = "<visual><geometry><mesh filename='../../etc/passwd.stl'/></geometry></visual>"
    draft = read(robot(LINKS.replace("<link name='b'/>", f"<link name='b'>{shape}</link>"), CHAIN))
    assert any("etc/passwd" in each and "outside" in each for each in draft.dropped)


def test_xacro_code_in_urdf_is_not_run_without_consent(read, tmp_path):
    trap = tmp_path / "ran"
    code = f"${{open('{trap}', 'w')}}"
    with pytest.raises(InputError, match="runs the Python expressions"):
        read(robot(LINKS.replace("'a'", f'"{code}"'), CHAIN))
    assert not trap.exists()


def test_description_with_only_macros_is_refused(read):
    with pytest.raises(FileFormatError, match="only macros"):
        read(robot("<xacro:macro xmlns:xacro='http://ros.org/wiki/xacro' name='m'/>"),
             "arm.xacro", allow_xacro=True)  # fmt: skip


def test_description_that_is_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "arm.urdf")
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_foreign(tmp_path / "arm.urdf", {}, {}, allow_xacro=False)


def test_import_ignores_pipe_in_description_folder(tmp_path):
    os.mkfifo(tmp_path / "arm.xml")
    for name in (None, "arm.xml", 5000 * "a"):
        with pytest.raises(InputError, match="has no "):
            choose_description(tmp_path, name)


def test_description_search_ends_in_folder_with_symlink_cycle(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "arm.urdf").write_text("<robot name='x'/>")
    (tmp_path / "inner" / "again").symlink_to(tmp_path)
    assert choose_description(tmp_path) == tmp_path / "inner" / "arm.urdf"


def test_refused_import_does_not_leave_files(tmp_path):
    (tmp_path / "arm.urdf").write_text(robot(LINKS, CHAIN, joint("j4", "d", "a")))
    code = ikservo.cli.main(
        ["arms", "new", "mine", "--from", str(tmp_path / "arm.urdf"), "--folder", str(tmp_path)]
    )
    assert code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf"]


@pytest.mark.parametrize("word", ["joint", "gripper"])
def test_long_link_chains_are_analysed_in_linear_time(word):
    def calls(count):
        links = "".join(f"<link name='l{i}'/>" for i in range(count + 1))
        joints = "".join(
            joint(f"{word}{i}", f"l{i}", f"l{i + 1}", "fixed" if i % 20 else "revolute")
            for i in range(count)
        )
        root = parse_xml(Path("arm.urdf"), robot(links, joints))
        profile = cProfile.Profile()
        profile.runcall(lambda: find_structures(urdf_from_xml(root, lambda _: None)))
        return sum(entry.callcount for entry in profile.getstats())

    assert calls(800) < 2.5 * calls(400)

"""Too large files of each kind are refused before they are parsed, inflated or multiplied."""

import json
import os
import struct

import numpy as np
import pytest

import ikservo
from ikservo.apps.importing import meshes
from ikservo.apps.importing.mesh_capsules import fit_capsules
from ikservo.apps.importing.meshes import MAX_TRIANGLES, read_triangles
from ikservo.apps.importing.mjcf import read_mjcf
from ikservo.apps.teaching.dataset_reading import MAX_FRAMES, read_dataset
from ikservo.apps.teaching.mcap_records import MAGIC, MAX_CHUNK_BYTES
from ikservo.apps.teaching.recorder import read_recording
from ikservo.errors import FileFormatError
from ikservo.files.drawing import read_drawing
from servosim.arm_file import read_arm_file
from servosim.errors import SimulatorError
from servosim.faults import read_faults
from servosim.specimen import read_specimen

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9">{}</svg>'
LINE = '<path id="a0" d="M0 0L1 1"/>'
NESTED = LINE + "".join(
    f'<g id="a{i}">{f"""<use href="#a{i - 1}"/>""" * 10}</g>' for i in range(1, 9)
)
DRAWINGS = {
    "nested uses": (f'{NESTED}<use href="#a8"/>', "elements, counted at each use"),
    "a circular use": (
        '<g id="a"><use href="#b"/></g><g id="b"><use href="#a"/></g>',
        "contains itself",
    ),
    "nested groups": ("<g>" * 65 + "</g>" * 65, "nests elements too deeply"),
    "a long path": (f'<path d="M0 0{"L1 1" * 30_000}"/>', "numbers and commands in its paths"),
    "long transforms": (f'<path transform="{"scale(1)" * 30_000}"/>', "numbers and commands"),
    "many attributes": (
        f"<g {' '.join(f'a{i}=' + repr('1') for i in range(3000))}>{LINE * 9000}</g>",
        "attributes that its elements inherit",
    ),
    "many style declarations": (
        f'<g style="{"".join(f"p{i}:b;" for i in range(3000))}">{LINE * 9000}</g>',
        "attributes that its elements inherit",
    ),
    "style sheets": (f"<style>{'.a{{}}' * 9000}</style>{LINE * 9000}", "style sheets to apply"),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_oversized_svg_is_refused_before_it_is_parsed(name, tmp_path, monkeypatch):
    svgelements = pytest.importorskip("svgelements")
    monkeypatch.setattr(svgelements.SVG, "parse", lambda *_, **__: pytest.fail("it was read"))
    body, words = DRAWINGS[name]
    (tmp_path / "a.svg").write_text(SVG.replace("{}", body))
    with pytest.raises(FileFormatError, match=words):
        read_drawing(tmp_path / "a.svg")


def test_svg_with_too_many_curves_is_refused_before_sampling(tmp_path, monkeypatch):
    pytest.importorskip("svgelements")
    monkeypatch.setattr("ikservo.files.drawing._sample_segments", lambda _: pytest.fail("sampled"))
    (tmp_path / "a.svg").write_text(SVG.replace("{}", f'<path d="M0 0{"t1 1" * 400}"/>'))
    with pytest.raises(FileFormatError, match="more than 20000 points"):
        read_drawing(tmp_path / "a.svg")


def test_csv_drawing_is_not_read_beyond_point_limit(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n" * 20_001 + "not read\n")
    with pytest.raises(FileFormatError, match="more than 20000 points"):
        read_drawing(tmp_path / "a.csv")


def record(kind, data):
    return bytes([kind]) + struct.pack("<Q", len(data)) + data


def chunk(stated, packed, compression):
    name = struct.pack("<I", len(compression)) + compression.encode()
    head = struct.pack("<QQQI", 0, 0, stated, 0) + name + struct.pack("<Q", len(packed))
    return record(6, head + packed)


def mcap_file(path, *chunks):
    start, end = record(1, bytes(8)), record(2, bytes(20))
    path.write_bytes(MAGIC + start + b"".join(chunks) + end + MAGIC)
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_mcap_chunk_is_decompressed_only_to_its_stated_size(compression, tmp_path):
    if compression == "zstd":
        packed = pytest.importorskip("zstandard").compress(bytes(50_000_000))
    else:
        packed = pytest.importorskip("lz4.frame").compress(bytes(50_000_000))
    path = mcap_file(tmp_path / "a.mcap", chunk(1000, packed, compression))
    tracemalloc = pytest.importorskip("tracemalloc")
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match="does not inflate to its stated size"):
            read_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.campaign
@pytest.mark.parametrize(("count", "words"), [(1, "a chunk of it inflates"), (20, "too much")])
def test_mcap_with_large_chunk_or_too_many_chunks_is_refused(count, words, tmp_path):
    zstandard = pytest.importorskip("zstandard")
    size = MAX_CHUNK_BYTES + 1 if count == 1 else MAX_CHUNK_BYTES
    packed = chunk(size, zstandard.compress(bytes(size)), "zstd")
    with pytest.raises(FileFormatError, match=words):
        read_recording(mcap_file(tmp_path / "a.mcap", *[packed] * count))


def test_recording_that_is_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.jsonl")
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_recording(tmp_path / "a.jsonl")


def test_recording_with_101_joints_is_refused(tmp_path):
    names = [f"j{i}" for i in range(101)]
    header = {"schema": "ikservo/recording/1", "arm": "a", "joints": names,
              "units": ["rad"] * 101, "period_s": 0.02}  # fmt: skip
    (tmp_path / "a.jsonl").write_text(json.dumps(header) + "\n")
    with pytest.raises(FileFormatError, match="has 101 joints"):
        read_recording(tmp_path / "a.jsonl")


@pytest.mark.parametrize(("rows", "width"), [(MAX_FRAMES + 1, 1), (10, 100_000)])
def test_data_set_with_too_many_frames_is_refused_before_reading(
    rows, width, tmp_path, monkeypatch
):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    values = pa.array(np.zeros(rows * width, dtype=np.float32))
    table = pa.table({
        "episode_index": np.zeros(rows, dtype=np.int64),
        "timestamp": np.zeros(rows, dtype=np.float32),
        "action": pa.FixedSizeListArray.from_arrays(values, width),
    })  # fmt: skip
    (tmp_path / "meta").mkdir()
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    pq.write_table(table, tmp_path / "data" / "chunk-000" / "file-000.parquet")
    features = {"action": {"names": ["j.pos"]}}
    info = {"codebase_version": "v3.0", "fps": 30, "features": features}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    monkeypatch.setattr(pq, "read_table", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(FileFormatError, match=r"frames of .* values"):
        read_dataset(tmp_path, "action")


def gltf(**parts):
    nodes = [{"mesh": 0}] * parts.get("nodes", 1)
    primitive = {"attributes": {"POSITION": 0}}
    accessor = {"componentType": 5126, "type": "VEC3", "count": parts["count"]}
    meshes = [{"primitives": [primitive]}]
    tree = {"asset": {"version": "2.0"}, "nodes": nodes, "meshes": meshes, "accessors": [accessor]}
    return json.dumps(tree).encode()


MESHES = {
    "binary.stl": bytes(84 + 50 * (MAX_TRIANGLES + 1)),
    "faces.obj": b"v 0 0 0" + b"\nf 1 1 1" * (MAX_TRIANGLES + 1),
    "zeros.gltf": gltf(count=10**9),
    "copies.gltf": gltf(count=3000, nodes=1000),
}


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<library_geometries><geometry id="g"><mesh>{}</mesh></geometry></library_geometries>
<library_nodes>{}</library_nodes>
<library_visual_scenes><visual_scene id="s">{}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
ONE, LEAF = '<triangles count="1"><p>0 1 2</p></triangles>', '<instance_geometry url="#g"/>'


def node(name, *inside):
    return f'<node id="{name}">{"".join(inside)}</node>'


def shown(name):
    return f'<instance_node url="#{name}"/>'


def doubled(depth):
    """Return nodes of which each refers to the one before twice."""
    return node("n0", LEAF) + "".join(
        node(f"n{i}", shown(f"n{i - 1}") * 2) for i in range(1, depth)
    )


SCENES = {
    "doubled thirty times": ((ONE, doubled(30), shown("n29")), "counting repeated parts each time"),
    "without a surface": (("", doubled(30), shown("n29")), "counting repeated parts each time"),
    "in a circle": (
        (ONE, node("a", shown("b")) + node("b", shown("a")), shown("a")),
        "contains itself",
    ),
    "in a long chain": (
        (ONE, node("n0") + "".join(node(f"n{i}", shown(f"n{i - 1}")) for i in range(1, 200)),
         shown("n199")), "at most 100 levels",
    ),
    "stated": (('<triangles count="300001"/>', "", node("r", LEAF)), "triangles"),
    "not stated": (
        (f'<triangles count="1"><p>{"0 " * 20_000}</p></triangles>', doubled(11), shown("n10") * 2),
        "characters",
    ),
    "nested nodes": ((ONE, "", "<node>" * 65 + "</node>" * 65), "nested too deeply"),
    "entities": (('<!DOCTYPE a [<!ENTITY b "c">]>', "", ""), "XML"),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_collada_with_too_many_instances_is_refused_early(name, tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "_load_mesh", lambda *_: pytest.fail("it was read"))
    parts, words = SCENES[name]
    with pytest.raises(FileFormatError, match=words):
        read_triangles(tmp_path / "a.dae", COLLADA.format(*parts).encode(), "base")


def test_collada_scene_with_few_instances_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "_load_mesh", lambda *_: np.ones((4, 3, 3)))
    text = COLLADA.format(ONE, doubled(3), node("r", shown("n2")))
    assert read_triangles(tmp_path / "a.dae", text.encode(), "base").shape == (4, 3, 3)


def sphere(triangles):
    """Return a closed ellipsoid with every corner on the hull: the worst case."""
    n = round((triangles / 2) ** 0.5)
    turn, fall = np.meshgrid(np.linspace(0, 2 * np.pi, n + 1), np.linspace(0, np.pi, n + 1))
    points = np.stack([np.cos(turn) * np.sin(fall), np.sin(turn) * np.sin(fall), np.cos(fall)], -1)
    points *= (0.1, 0.05, 0.03)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    pairs = [np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]
    return np.concatenate([each.reshape(-1, 3, 3) for each in pairs])


@pytest.mark.full
def test_fitted_capsules_contain_every_vertex_of_large_mesh():
    triangles = sphere(MAX_TRIANGLES // 3)
    fit = fit_capsules(triangles)
    inside = [capsule.depth_m(triangles.reshape(-1, 3)) for capsule in fit.capsules]
    assert np.max(inside, axis=0).min() >= 0.0


def joint_states(path, messages):
    """Write an MCAP file with joint states: names and positions."""
    writing = pytest.importorskip("mcap.writer")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = (store.types[name] for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header",
                                            "builtin_interfaces/msg/Time"))  # fmt: skip
    state, header, stamp = kinds
    with path.open("wb") as file:
        writer = writing.Writer(file, compression=writing.CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        none = np.zeros(0)
        for at, names in enumerate(messages, start=1):
            positions = np.full(len(names), float(at))
            message = state(header(stamp(at, 0), ""), names, positions, none, none)
            data = bytes(store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
            writer.add_message(channel, at, data, at)
        writer.finish()
    return path


@pytest.mark.full
def test_mcap_recording_needs_memory_below_5_times_its_size(tmp_path):
    tracemalloc = pytest.importorskip("tracemalloc")
    names = [f"a_joint_with_a_name_{i}" for i in range(6)]
    path = joint_states(tmp_path / "a.mcap", [names] * 10_000)
    read_recording(path)  # imports
    tracemalloc.start()
    try:
        read_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 5 * path.stat().st_size
    finally:
        tracemalloc.stop()


def test_mcap_joint_limit_applies_to_all_messages_together(tmp_path):
    path = joint_states(tmp_path / "a.mcap", [[f"j{i}"] for i in range(101)])
    with pytest.raises(FileFormatError, match="at most 100 joints"):
        read_recording(path)


def test_mcap_joints_from_separate_messages_are_combined(tmp_path):
    path = joint_states(tmp_path / "a.mcap", [["a"], ["b"], ["a"], ["b", "a"]])
    recording = read_recording(path)
    assert recording.header.joints == ("a", "b")
    np.testing.assert_array_equal(recording.joints, [[1, 2], [3, 2], [4, 4]])


OWN_FILES = {
    "large.toml": b"#" * (256 * 1024 + 1),
    "dots.toml": b"a" + b".a" * 100_000 + b" = 1",
    "deep.toml": b"a = " + b"[" * 100_000,
    "deep.json": b"[" * 200_000,
}


@pytest.mark.parametrize("name", OWN_FILES)
def test_simulator_files_above_their_limits_are_refused(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(OWN_FILES[name])
    readers = (
        [read_faults] if name.endswith("json") else [read_faults, read_arm_file, read_specimen]
    )
    for read in readers:
        with pytest.raises(SimulatorError, match=r"KiB|dots|nested"):
            read(path)


def test_simulator_file_that_is_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.toml")
    with pytest.raises(SimulatorError, match="not a regular file"):
        read_arm_file(tmp_path / "a.toml")


@pytest.mark.parametrize("name", MESHES)
def test_mesh_with_too_many_triangles_is_refused_before_reading(name, tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "_load_mesh", lambda *_: pytest.fail("it was read"))
    with pytest.raises(FileFormatError, match="triangles"):
        read_triangles(tmp_path / name, MESHES[name], "base")


@pytest.mark.full
def test_capsule_fit_of_6000_points_needs_less_than_30_mb():
    tracemalloc = pytest.importorskip("tracemalloc")
    angles = np.linspace(0.0, np.pi, 6000)
    points = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6000)])
    tracemalloc.start()
    try:
        fit_capsules(points.reshape(-1, 3, 3))
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


MULTIPLIED = {
    "replicate": '<worldbody><replicate count="9999999"><geom size="1"/></replicate></worldbody>',
}


@pytest.mark.parametrize("name", MULTIPLIED)
def test_oversized_mjcf_is_refused_before_it_is_compiled(name, tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(f"<mujoco>{MULTIPLIED[name]}</mujoco>")
    with pytest.raises(ikservo.IkservoError, match=r"cannot be used|has (width|nuser_geom)="):
        read_mjcf(tmp_path / "arm.xml")

"""Of each kind of file too much is refused before it is parsed, inflated or multiplied."""

import json
import os
import struct

import numpy as np
import pytest

import ikservo
from ikservo.arm.dataset_reading import MAX_FRAMES, read_dataset
from ikservo.arm.mcap_records import MAGIC, MAX_CHUNK_BYTES
from ikservo.arm.recorder import read_recording
from ikservo.errors import FileFormatError
from ikservo.files.drawing import read_drawing
from ikservo.model.loading import read_description
from ikservo.model.meshes import MAX_TRIANGLES, fit_capsules, read_triangles

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9">{}</svg>'
LINE = '<path id="a0" d="M0 0L1 1"/>'
NESTED = LINE + "".join(
    f'<g id="a{i}">{f"""<use href="#a{i - 1}"/>""" * 10}</g>' for i in range(1, 9)
)
DRAWINGS = {
    "nested uses": (f'{NESTED}<use href="#a8"/>', "elements, each as often as it is used"),
    "a circular use": (
        '<g id="a"><use href="#b"/></g><g id="b"><use href="#a"/></g>',
        "contains itself",
    ),
    "nested groups": ("<g>" * 65 + "</g>" * 65, "nests elements too deeply"),
    "a long path": (f'<path d="M0 0{"L1 1" * 30_000}"/>', "numbers and commands in its paths"),
    "long transforms": (f'<path transform="{"scale(1)" * 30_000}"/>', "numbers and commands"),
    "style sheets": (f"<style>{'.a{{}}' * 9000}</style>{LINE * 9000}", "style sheets to apply"),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_an_svg_is_refused_before_it_is_read_for(name, tmp_path, monkeypatch):
    svgelements = pytest.importorskip("svgelements")
    monkeypatch.setattr(svgelements.SVG, "parse", lambda *_, **__: pytest.fail("it was read"))
    body, words = DRAWINGS[name]
    (tmp_path / "a.svg").write_text(SVG.replace("{}", body))
    with pytest.raises(FileFormatError, match=words):
        read_drawing(tmp_path / "a.svg")


def test_curves_are_counted_before_they_are_sampled(tmp_path, monkeypatch):
    pytest.importorskip("svgelements")
    monkeypatch.setattr("ikservo.files.drawing._sample_segments", lambda _: pytest.fail("sampled"))
    (tmp_path / "a.svg").write_text(SVG.replace("{}", f'<path d="M0 0{"t1 1" * 400}"/>'))
    with pytest.raises(FileFormatError, match="more than 20000 points"):
        read_drawing(tmp_path / "a.svg")


def test_a_csv_is_read_no_further_than_its_last_point(tmp_path):
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
def test_a_chunk_of_an_mcap_is_inflated_to_what_it_states_at_most(compression, tmp_path):
    if compression == "zstd":
        packed = pytest.importorskip("zstandard").compress(bytes(50_000_000))
    else:
        packed = pytest.importorskip("lz4.frame").compress(bytes(50_000_000))
    path = mcap_file(tmp_path / "a.mcap", chunk(1000, packed, compression))
    tracemalloc = pytest.importorskip("tracemalloc")
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match="another size than it states"):
            read_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("count", "words"), [(1, "a chunk of it inflates"), (20, "too much")])
def test_a_large_chunk_or_many_of_an_mcap_are_refused(count, words, tmp_path):
    zstandard = pytest.importorskip("zstandard")
    size = MAX_CHUNK_BYTES + 1 if count == 1 else MAX_CHUNK_BYTES
    packed = chunk(size, zstandard.compress(bytes(size)), "zstd")
    with pytest.raises(FileFormatError, match=words):
        read_recording(mcap_file(tmp_path / "a.mcap", *[packed] * count))


def test_a_recording_that_is_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.jsonl")
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_recording(tmp_path / "a.jsonl")


def test_a_recording_has_at_most_a_hundred_joints(tmp_path):
    names = [f"j{i}" for i in range(101)]
    header = {"schema": "ikservo/recording/1", "arm": "a", "joints": names,
              "units": ["rad"] * 101, "period_s": 0.02}  # fmt: skip
    (tmp_path / "a.jsonl").write_text(json.dumps(header) + "\n")
    with pytest.raises(FileFormatError, match="has 101 joints"):
        read_recording(tmp_path / "a.jsonl")


@pytest.mark.parametrize(("rows", "width"), [(MAX_FRAMES + 1, 1), (10, 100_000)])
def test_frames_of_a_data_set_are_counted_before_they_are_read(rows, width, tmp_path, monkeypatch):
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


@pytest.mark.parametrize("name", MESHES)
def test_triangles_are_counted_before_a_mesh_is_read(name, tmp_path, monkeypatch):
    monkeypatch.setattr("ikservo.model.meshes._load_mesh", lambda *_: pytest.fail("it was read"))
    with pytest.raises(FileFormatError, match="triangles"):
        read_triangles(tmp_path / name, MESHES[name], "base")


def test_fitting_needs_no_memory_that_grows_with_the_square_of_the_points():
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
    "texture": '<asset><texture builtin="flat" width="99999" height="99999"/></asset>',
    "user data": '<size nuser_geom="999999999"/>',
}


@pytest.mark.parametrize("name", MULTIPLIED)
def test_an_mjcf_is_refused_before_it_is_compiled_for(name, tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(f"<mujoco>{MULTIPLIED[name]}</mujoco>")
    with pytest.raises(ikservo.IkservoError, match=r"is not for arms|has (width|nuser_geom)="):
        read_description(tmp_path / "arm.xml")

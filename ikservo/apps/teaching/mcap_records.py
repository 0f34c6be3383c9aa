"""Read MCAP records without inflating more than the declared size."""

from __future__ import annotations

import importlib
import struct
import warnings
import zlib
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

from ikservo.errors import FileFormatError, IkservoError
from ikservo.files.reading import require_file
from ikservo.remedies import install_command

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file."""

MAX_CHUNK_BYTES = 32 * 1024 * 1024
"""Largest inflated size of a chunk; writers make chunks of about 1 to 10 MiB."""

# Largest inflated size of all chunks, for a small file and as a multiple of a large file's size.
_MAX_INFLATED_BYTES, _MAX_RATIO = 256 * 1024 * 1024, 10
_RECORD_HEAD, _MESSAGE, _DEFINITIONS = struct.Struct("<BQ"), 5, (3, 4)
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_MAX_DEFINITIONS = 10_000
_MAX_RECORD_BYTES = 64 * 1024 * 1024


def import_mcap() -> Any:  # noqa: ANN401  # a module
    """Return the MCAP module; if it is missing, raise an error that names the package."""
    try:
        import mcap.writer  # noqa: PLC0415  # from an extra
    except ImportError:
        raise IkservoError(
            "MCAP files need the package mcap, which is not installed.",
            f"Install it: {install_command('record')}",
        ) from None
    return mcap.writer


def read_records(path: Path, wanted: Container[int] = ()) -> Iterator[Any]:
    """Yield the records of an MCAP file; a truncated file ends with its last whole record.

    Messages in chunks are yielded only for the wanted channels, because there may be a million. A
    damaged file also ends early, with a warning that names the position.

    Raises:
        FileFormatError: The file cannot be read.
    """
    require_file(path)
    import_mcap()
    from mcap.stream_reader import StreamReader  # noqa: PLC0415

    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FileFormatError(
                    path, "", "is not an MCAP file", "a file written by ikservo record"
                )
            file.seek(0)
            reader = StreamReader(
                cast("IO[bytes]", _BoundedReads(file)), validate_crcs=True, emit_chunks=True,
                record_size_limit=_MAX_RECORD_BYTES,
            )  # fmt: skip
            try:
                most = max(_MAX_INFLATED_BYTES, _MAX_RATIO * path.stat().st_size)
                for record in reader.records:
                    most -= getattr(record, "uncompressed_size", 0)
                    if most < 0:
                        raise FileFormatError(path, "", "has too much data", "a shorter file")
                    yield from _records_of_chunk(path, record, wanted)
            except (FileFormatError, OSError):
                raise
            except Exception as error:  # the reader has no error class for truncated files
                if file.read(1):
                    where = f"{path} is damaged near byte {file.tell() - 1} ({error})"
                    text = f"{where}; only the part before it is read."
                    warnings.warn(text, RuntimeWarning, stacklevel=1)
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})") from error


class _BoundedReads:
    """A file that refuses reads longer than the largest record, because a length may be wrong."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """Read the next bytes.

        Raises:
            ValueError: Too many bytes are requested.
        """
        if size > _MAX_RECORD_BYTES:
            raise ValueError(f"a record of {size} bytes is too long")
        return self._file.read(size)


def _records_of_chunk(path: Path, record: Any, wanted: Container[int]) -> Iterator[Any]:  # noqa: ANN401  # mcap's
    """Return the records in a chunk, inflated to its declared size at most; pass others on."""
    from mcap.records import Chunk, Message  # noqa: PLC0415
    from mcap.stream_reader import breakup_chunk  # noqa: PLC0415

    if not isinstance(record, Chunk):
        yield record
        return
    if record.uncompressed_size > MAX_CHUNK_BYTES:
        found = f"one of its chunks inflates to {record.uncompressed_size:,} bytes"
        raise FileFormatError(path, "", found, f"chunks of at most {MAX_CHUNK_BYTES:,} bytes")
    if record.compression in _INFLATE:
        data = _INFLATE[record.compression](record.data, record.uncompressed_size + 1)
        if len(data) != record.uncompressed_size:
            found = "one of its chunks does not inflate to its stated size"
            raise FileFormatError(path, "", found, "an undamaged MCAP file")
        record = replace(record, data=data, compression="")
    if record.uncompressed_crc not in (0, zlib.crc32(record.data)):
        raise ValueError("the checksum of a chunk is wrong")
    at, others, data = 0, 0, record.data
    while at + _RECORD_HEAD.size <= len(data):
        kind, length = _RECORD_HEAD.unpack_from(data, at)
        end = at + _RECORD_HEAD.size + length
        channel = int.from_bytes(data[at + 9 : at + 11], "little")
        others += kind in _DEFINITIONS
        if others > _MAX_DEFINITIONS:
            found = "one of its chunks has too many channels and schemas"
            raise FileFormatError(path, "", found, f"at most {_MAX_DEFINITIONS:,}")
        if kind == _MESSAGE and channel in wanted:  # a reader per message is slow
            head = _MESSAGE_HEAD.unpack_from(data, at + _RECORD_HEAD.size)
            channel_id, sequence, log_time, publish_time = head
            start = at + _RECORD_HEAD.size + _MESSAGE_HEAD.size
            yield Message(channel_id, log_time, data[start:end], publish_time, sequence)
        elif kind in _DEFINITIONS:
            one = replace(record, data=data[at:end], compression="", uncompressed_crc=0)
            yield from breakup_chunk(one)
        at = end


def _inflate_zstd(data: bytes, most: int) -> bytes:
    import zstandard  # noqa: PLC0415

    with zstandard.ZstdDecompressor().stream_reader(data) as stream:
        return stream.read(most)


def _inflate_lz4(data: bytes, most: int) -> bytes:
    frame: Any = importlib.import_module("lz4.frame")
    return frame.LZ4FrameDecompressor().decompress(data, max_length=most)


_INFLATE: Mapping[str, Callable[[bytes, int], bytes]] = {
    "zstd": _inflate_zstd,
    "lz4": _inflate_lz4,
}

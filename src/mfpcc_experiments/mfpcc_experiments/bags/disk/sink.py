"""An MCAP file that grows by whole chunks, and its end as rosbag2 writes it."""

from __future__ import annotations

import fcntl
import os
import zlib
from array import array
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from mfpcc_experiments.bags.disk.mcap_format import CHUNK_HEAD, MAGIC, RECORD_HEAD, encode
from mfpcc_experiments.bags.disk.written_chunk import INDEX_HEAD, WrittenChunk
from mfpcc_experiments.bags.metadata import (
    METADATA,
    PartInfo,
    bag_metadata,
    to_yaml,
    write_metadata,
)
from mfpcc_experiments.bags.provenance import SUMMARY_RECORD, json_record

_LZ4 = b"lz4"


@dataclass
class McapSink:
    """
    An MCAP file that grows by whole chunks, and can be finished after any of them.

    Parameters
    ----------
    path : Path
        File; must not exist.

    Attributes
    ----------
    schemas, channels : dict
        Records by id; they must also be in the chunks (see `BagWriter`), here for the summary.
    chunks : list of bytes
        The chunks written so far, see `WrittenChunk.kept`.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        # No buffer: what was handed over survives the death of the process.
        self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115 (closed by finish)
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(self._file, fcntl.LOCK_EX)  # says that it is being written
        self._offset = 0
        self._crc = 0
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._write(MAGIC + encode(Header(profile="ros2", library="mfpcc")))

    def _write(self, data: bytes) -> None:
        """Append all of `data`, or nothing."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except BaseException:
            self._file.truncate(self._offset)
            self._file.seek(self._offset)
            raise
        self._offset += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Append a metadata record."""
        record = encode(Metadata(name=name, metadata=dict(data)))
        index = MetadataIndex(offset=self._offset, length=len(record), name=name)
        self._write(record)
        self._metadata.append(index)

    def attachment(self, content: bytes, attachment: Attachment) -> None:
        """Append an attachment as it stood in another file, where it was read as `attachment`."""
        record = RECORD_HEAD.pack(Opcode.ATTACHMENT, len(content)) + content
        index = AttachmentIndex(
            offset=self._offset,
            length=len(record),
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._write(record)
        self._attachments.append(index)

    def record(self, opcode: int, content: bytes) -> None:
        """Append a record that needs no index."""
        self._write(RECORD_HEAD.pack(opcode, len(content)) + content)

    def chunk(self, records: bytes | bytearray, index: Mapping[int, array[int]]) -> None:
        """
        Append a chunk and its message indexes.

        Parameters
        ----------
        records : bytes
            The records of the chunk.
        index : mapping
            Per channel id the log time (ns) and offset of each message, alternating; layout of the
            MCAP message index.
        """
        packed = lz4.frame.compress(records, content_checksum=False, store_size=True)
        entries = {cid: np.frombuffer(a, np.uint64).reshape(-1, 2) for cid, a in index.items() if a}
        if not entries:
            return
        start = min(int(a[:, 0].min()) for a in entries.values())
        end = max(int(a[:, 0].max()) for a in entries.values())
        head = CHUNK_HEAD.pack(start, end, len(records), zlib.crc32(records), len(_LZ4))
        body = head + _LZ4 + len(packed).to_bytes(8, "little") + packed
        head = RECORD_HEAD.pack(Opcode.CHUNK, len(body))
        parts = [head, body]
        chunk_length = len(head) + len(body)
        for cid, a in entries.items():
            content = INDEX_HEAD.pack(cid, a.nbytes) + a.tobytes()
            parts += [RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, len(content)), content]
        before = (self._offset, self._crc)
        self._write(b"".join(parts))
        counts = {cid: len(a) for cid, a in entries.items()}
        written = WrittenChunk(*before, start, end, chunk_length, len(packed), len(records), counts)
        self.chunks.append(written.kept())

    def take_back(self) -> None:
        """Remove the last chunk and what came after it, to make room on a full disk."""
        chunk = WrittenChunk.from_kept(self.chunks.pop())
        self._file.truncate(chunk.offset)
        self._file.seek(chunk.offset)
        self._offset, self._crc = chunk.offset, chunk.crc
        self._metadata = [m for m in self._metadata if m.offset < chunk.offset]
        self._attachments = [a for a in self._attachments if a.offset < chunk.offset]

    def _written(self) -> Iterator[WrittenChunk]:
        return map(WrittenChunk.from_kept, self.chunks)

    @property
    def counts(self) -> dict[int, int]:
        """Messages per channel id."""
        total = dict.fromkeys(self.channels, 0)
        for chunk in self._written():
            for cid, count in chunk.counts.items():
                total[cid] += count
        return total

    @property
    def times(self) -> tuple[int, int]:
        """First and last log time (ns); zero for an empty file."""
        if not self.chunks:
            return 0, 0
        starts, ends = zip(*((chunk.start, chunk.end) for chunk in self._written()), strict=True)
        return min(starts), max(ends)

    def info(self) -> PartInfo:
        """What ``metadata.yaml`` tells of the file."""
        return PartInfo(self.path.name, self.channels, self.schemas, self.counts, self.times)

    def finish(self) -> None:
        """Append the end of the data, the summary and the footer (all or nothing)."""
        end = encode(DataEnd(data_section_crc=self._crc))
        start = self._offset + len(end)
        first, last = self.times
        counts = self.counts
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, list(self.schemas.values())),
            (Opcode.CHANNEL, list(self.channels.values())),
            (
                Opcode.STATISTICS,
                [
                    Statistics(
                        attachment_count=len(self._attachments),
                        channel_count=len(self.channels),
                        channel_message_counts=counts,
                        chunk_count=len(self.chunks),
                        message_count=sum(counts.values()),
                        message_start_time=first,
                        message_end_time=last,
                        metadata_count=len(self._metadata),
                        schema_count=len(self.schemas),
                    )
                ],
            ),
            (Opcode.CHUNK_INDEX, (chunk.record(_LZ4.decode()) for chunk in self._written())),
            (Opcode.ATTACHMENT_INDEX, list(self._attachments)),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        ]
        summary = b""
        table = b""
        for opcode, records in groups:
            data = b"".join(encode(record) for record in records)
            if data:
                table += encode(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        footer = Footer(
            summary_start=start, summary_offset_start=start + len(summary), summary_crc=0
        )
        covered = summary + table + encode(footer)[:-4]
        footer.summary_crc = zlib.crc32(covered)
        self._write(end + summary + table + encode(footer) + MAGIC)

    def sync(self) -> None:
        """Have the disk keep what was written."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()


def end_file(sink: McapSink, summary: Mapping[str, Any], custom: Mapping[str, str]) -> None:
    """
    Append to an MCAP file what belongs at its end.

    Parameters
    ----------
    sink : McapSink
        The file with all its chunks.
    summary : mapping
        JSON content of the summary record.
    custom : mapping of str
        ``custom_data`` of the metadata.
    """
    sink.metadata("rosbag2", {"serialized_metadata": to_yaml(bag_metadata([sink.info()], custom))})
    sink.metadata(SUMMARY_RECORD, json_record(summary))
    sink.finish()


def finish_bag(sink: McapSink, summary: Mapping[str, Any], custom: Mapping[str, str]) -> int:
    """
    Finish a bag: summary, footer, ``metadata.yaml``.

    Where the disk is too full even for these, chunks are taken back from the end until they fit.

    Parameters
    ----------
    sink : McapSink
        The file with all its chunks.
    summary, custom
        As of `end_file`.

    Returns
    -------
    int
        Number of chunks that had to be taken back.
    """
    folder = sink.path.parent
    taken = 0
    while True:
        temporary = None
        try:
            # The small file first, then the end of the large one; renamed when both are there.
            temporary = write_metadata(folder, [sink.info()], custom)
            end_file(sink, summary, custom)
            break
        except OSError:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
            if not sink.chunks:
                sink.close()
                raise
            sink.take_back()
            taken += 1
    sink.close()
    os.replace(temporary, folder / METADATA)
    return taken

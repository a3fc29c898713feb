"""
Repairing a recording whose writer was killed, or whose file was damaged.

All whole chunks are copied into a new file, with the metadata and attachments, and that is finished
as a writer would have done it. A chunk whose checksum does not match is dropped, never guessed.
Messages behind the last period that all topics have are left out (`ragged`). The copy is read back
before it takes the place of the old file, and wherever that holds anything that the copy does not,
be it bytes that nobody can read, it stays beside it as ``*.damaged``.
"""

from __future__ import annotations

import os
import zlib
from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment

from mfpcc_experiments.bags.bag_parts import Parts, candidates, parts_of
from mfpcc_experiments.bags.disk import mcap_file
from mfpcc_experiments.bags.disk.mcap_format import MESSAGE_HEAD, RECORD_HEAD, encode, parse, walk
from mfpcc_experiments.bags.disk.sink import McapSink, end_file
from mfpcc_experiments.bags.errors import BagError, DamagedError, UnfinishedError
from mfpcc_experiments.bags.metadata import METADATA, write_metadata
from mfpcc_experiments.bags.provenance import CONFIG_RECORD, SUMMARY_RECORD, custom_data
from mfpcc_experiments.bags.ragged import Tails
from mfpcc_experiments.scratch import scratch

_OWN_RECORDS = ("rosbag2", SUMMARY_RECORD)  # written anew


def recover(path: Path) -> str:
    """
    Repair a recording in place.

    Parameters
    ----------
    path : Path
        Folder of a bag, or one of its MCAP files.

    Returns
    -------
    str
        What was saved, in a sentence.

    Raises
    ------
    BagError
        If there is nothing to save, or a file cannot be read or written. All is as it was then.
    """
    path = Path(path)
    parts, missing = _parts(path)
    folder = parts.files[0].parent
    # The metadata.yaml of a bag tells of all its parts: it is written when all were looked at.
    whole = path.is_dir() or len(list(folder.glob("*.mcap"))) == 1
    try:
        with scratch(".recover-", folder) as workshop:
            copies = [_Copy(file, workshop / file.name) for file in parts.files]
            tails = Tails()
            for copy in copies:
                copy.run(tails)
            lacking = whole and not (folder / METADATA).exists()
            broken = [copy for copy in copies if copy.problem is not None]
            if not broken and missing is not None:
                raise missing
            if not broken and not lacking:
                return f"{path}: whole, nothing to repair"
            if not any(copy.sink.chunks for copy in copies):
                raise BagError(
                    f"{path}: nothing to save: the file holds no whole chunk of messages"
                )
            if copies[-1] in broken:
                copies[-1] = broken[-1] = _without_ragged_end(copies[-1], tails)
            for copy in broken:
                copy.finish()
                copy.check()
            metadata = None
            if whole:
                custom = {key: value for copy in copies for key, value in copy.custom.items()}
                information = [copy.sink.info() for copy in copies]
                metadata = write_metadata(workshop, information, {**custom, **parts.custom_data})
            for copy in broken:
                _replace(copy)
            if metadata is not None:
                os.replace(metadata, folder / METADATA)
            _sync(folder)
    except OSError as error:
        raise BagError(f"{error.filename or path}: {error.strerror}") from None
    if not broken:
        return f"{path}: the recording is whole; its {METADATA} was missing and was written"
    text = _report(path, broken, tails.ends() if copies[-1] in broken else [])
    return text if missing is None else f"{text}; what cannot be repaired: {missing}"


def _parts(path: Path) -> tuple[Parts, BagError | None]:
    """Files to repair, and what is wrong with the bag where one of them is missing."""
    missing = None
    try:
        parts = parts_of(path)
    except BagError as error:
        missing = error
        files = candidates(path) if path.is_dir() else []
        if not files:
            raise
        parts = Parts(files)
    for file in parts.files:
        if file.suffix != ".mcap":
            raise BagError(f"{file}: only MCAP recordings can be repaired")
        if mcap_file.is_being_written(file):
            raise BagError(f"{file}: is being written at this moment; there is nothing to repair")
    return parts, missing


def _without_ragged_end(copy: _Copy, tails: Tails) -> _Copy:
    """The last copy again, without messages behind the last period that all topics have."""
    counts = {copy.sink.channels[cid].topic: 0 for cid in copy.sink.channels}
    for cid, count in copy.sink.counts.items():
        counts[copy.sink.channels[cid].topic] += count
    ragged = tails.too_many()
    if not ragged or any(counts.get(topic, 0) <= count for topic, count in ragged.items()):
        return copy
    copy.sink.close()
    copy.sink.path.unlink()
    keep = {topic: counts[topic] - count for topic, count in ragged.items()}
    again = _Copy(copy.source, copy.sink.path, keep)
    again.run(Tails())
    return again


def _replace(copy: _Copy) -> None:
    """Put a copy in the place of its file, of which nothing is given up."""
    size, time = copy.state
    status = copy.source.stat()
    if (status.st_size, status.st_mtime_ns) != (size, time):
        raise BagError(f"{copy.source}: has changed meanwhile: is it being written?")
    if copy.leaves_out:
        kept = copy.source.with_name(copy.source.name + ".damaged")
        number = 1
        while kept.exists():
            number += 1
            kept = copy.source.with_name(f"{copy.source.name}.{number}.damaged")
        os.link(copy.source, kept)  # before anything is replaced
        copy.kept = kept
    os.replace(copy.sink.path, copy.source)


def _sync(folder: Path) -> None:
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class _Copy:
    """
    The whole parts of `source`, copied to `target`.

    Parameters
    ----------
    source, target : Path
        The file, and where its copy goes.
    keep : mapping of int, optional
        Of these topics only so many messages are copied.
    """

    def __init__(self, source: Path, target: Path, keep: Mapping[str, int] | None = None) -> None:
        self.source = source
        self.sink = McapSink(target)
        status = source.stat()
        self.state = status.st_size, status.st_mtime_ns
        self.problem: BagError | None = None
        self.damaged = 0
        self.ragged = 0
        self._keep = dict(keep or {})
        self.kept: Path | None = None
        self.custom: dict[str, str] = {}
        self._end = 0
        self._checksums: dict[str, int] = {}
        self._summary: dict[str, object] = {}
        self._channels = mcap_file.Channels(source)
        # The chunk that says what the channels are may be the damaged one; the summary says it too.
        with suppress(DamagedError):
            for record in mcap_file.summary(source):
                self._channels.see(record.opcode, record.content)
        self._sent: set[int] = set()

    def run(self, tails: Tails) -> None:
        """Copy until the end of the file, or of what can be read of it; `tails` takes note."""
        self._tails = tails
        try:
            for record in mcap_file.blocks(self.source):
                try:
                    self._record(record)
                except DamagedError as error:
                    self.problem = error
                    self.damaged += 1
                self._end = record.end
        except (UnfinishedError, DamagedError) as error:
            self.problem = self.problem or error
            if isinstance(error, DamagedError) and not self.damaged:
                self.damaged = 1
        for channel_id in sorted(set(self._channels.channels) - set(self.sink.channels)):
            self._keep_silent(channel_id)

    @property
    def leaves_out(self) -> bool:
        """Whether the source holds anything that the copy does not."""
        return bool(self.damaged or self.ragged) or self._end < self.state[0]

    def _record(self, record: mcap_file.Record) -> None:
        if record.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            self._block(mcap_file.block(record, self._channels))
        elif record.opcode == Opcode.METADATA:
            self._metadata(record)
        elif record.opcode == Opcode.ATTACHMENT:
            attachment = parse(Attachment, record.content, self.source)
            self.sink.attachment(record.content, attachment)
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._channels.see(record.opcode, record.content)
        elif record.opcode not in (Opcode.HEADER, Opcode.MESSAGE_INDEX):
            self.sink.record(record.opcode, record.content)  # unknown here, known to another

    def _metadata(self, record: mcap_file.Record) -> None:
        name, entries, value = mcap_file.metadata(record, self.source)
        if name == SUMMARY_RECORD and isinstance(value, dict):
            self._summary = value
        if name == CONFIG_RECORD and isinstance(value, dict):
            self.custom = custom_data(value)
        if name not in _OWN_RECORDS:
            self.sink.metadata(name, entries)

    def _block(self, block: mcap_file.Block) -> None:
        """Copy one chunk; its index is made anew."""
        if self._keep:
            block = self._cut(block)
        data, messages = block.data, block.messages
        there = self._sent | block.channels
        used = np.unique(messages.channel_id).tolist()
        for channel_id in used:
            self._channels.topic(channel_id)  # known, or the chunk is of no use
        if not used:
            return  # what it says of its channels is said again where one is used
        # What a dropped chunk said of its channels is said again.
        head = b"".join(self._description(cid) for cid in sorted(set(used) - there))
        index: dict[int, array[int]] = {}
        offset = messages.begin - MESSAGE_HEAD.size + len(head)
        for channel_id in used:
            rows = messages.channel_id == channel_id
            pairs = np.stack([messages.log_time[rows], offset[rows].astype(np.uint64)], axis=1)
            index[channel_id] = array("Q", pairs.tobytes())
            self._know(channel_id)
        times = messages.log_time.tolist()
        for at, (topic, message) in zip(times, _messages(block, self._channels), strict=True):
            self._checksums[topic.name] = zlib.crc32(message, self._checksums.get(topic.name, 0))
            self._tails.see(topic, at, message)
        self.sink.chunk(head + data, index)
        self._sent = there | set(used)

    def _cut(self, block: mcap_file.Block) -> mcap_file.Block:
        """A block without the messages that are more than is to be kept of their topics."""
        messages = block.messages
        keep = np.ones(len(messages.channel_id), np.bool_)
        for n, channel_id in enumerate(messages.channel_id.tolist()):
            topic = self._channels.topic(channel_id).name
            if topic in self._keep:
                keep[n] = self._keep[topic] > 0
                self._keep[topic] -= int(keep[n])
        if keep.all():
            return block
        self.ragged += int(np.count_nonzero(~keep))
        left, at = bytearray(), 0
        for begin, end in zip(messages.begin[~keep], messages.end[~keep], strict=True):
            left += block.data[at : begin - MESSAGE_HEAD.size]
            at = int(end)
        left += block.data[at:]
        _, rest = walk(bytes(left), self.source)
        return mcap_file.Block(bytes(left), rest, block.channels)

    def _know(self, channel_id: int) -> None:
        """Put a channel into the summary."""
        channel = self._channels.channels[channel_id]
        self.sink.channels[channel_id] = channel
        if channel.schema_id in self._channels.schemas:
            self.sink.schemas[channel.schema_id] = self._channels.schemas[channel.schema_id]

    def _keep_silent(self, channel_id: int) -> None:
        """Keep a channel that has no messages."""
        if channel_id not in self._sent:
            channel = self._channels.channels[channel_id]
            for record in (self._channels.schemas.get(channel.schema_id), channel):
                if record is not None:
                    data = encode(record)
                    self.sink.record(data[0], data[RECORD_HEAD.size :])
        self._know(channel_id)

    def _description(self, channel_id: int) -> bytes:
        """Schema and channel records of a channel."""
        channel = self._channels.channels[channel_id]
        schema = self._channels.schemas.get(channel.schema_id)
        return (b"" if schema is None else encode(schema)) + encode(channel)

    def finish(self) -> None:
        """Finish the copy."""
        if self.problem is not None:
            reason = "the file was damaged" if self.damaged else "the writer was killed"
            self._summary["incomplete"] = f"recovered: {reason}"
        end_file(self.sink, self._summary, self.custom)
        self.sink.sync()
        self.sink.close()

    def check(self) -> None:
        """
        Read the copy back, with this reader and with that of the MCAP project.

        Raises
        ------
        BagError
            If it does not hold every message that was copied.
        """
        path = self.sink.path
        expected = {self.sink.channels[cid].topic: 0 for cid in self.sink.channels}
        for cid, count in self.sink.counts.items():
            expected[self.sink.channels[cid].topic] += count
        counts = dict.fromkeys(expected, 0)
        checksums: dict[str, int] = {}
        channels = mcap_file.Channels(path)
        try:
            for record in mcap_file.blocks(path):
                if record.opcode != Opcode.CHUNK:
                    channels.see(record.opcode, record.content)
                    continue
                block = mcap_file.block(record, channels)
                for topic, message in _messages(block, channels):
                    counts[topic.name] += 1
                    checksums[topic.name] = zlib.crc32(message, checksums.get(topic.name, 0))
            with open(path, "rb") as file:
                summary = make_reader(file).get_summary()
            statistics = summary.statistics if summary is not None else None
        except (BagError, McapError, KeyError) as error:
            raise BagError(f"{self.source}: the repaired copy cannot be read: {error}") from None
        stated = statistics.message_count if statistics is not None else -1
        if (counts, checksums, stated) != (expected, self._checksums, sum(expected.values())):
            raise BagError(f"{self.source}: the repaired copy does not hold what was copied")


def _messages(
    block: mcap_file.Block, channels: mcap_file.Channels
) -> Iterator[tuple[mcap_file.Topic, memoryview]]:
    """Topic and bytes of each message of a block."""
    topics = {cid: channels.topic(cid) for cid in np.unique(block.messages.channel_id).tolist()}
    data = memoryview(block.data)
    for cid, begin, end in zip(
        block.messages.channel_id.tolist(),
        block.messages.begin.tolist(),
        block.messages.end.tolist(),
        strict=True,
    ):
        yield topics[cid], data[begin:end]


def _report(path: Path, copies: list[_Copy], ends: list[int]) -> str:
    """What was saved, in a sentence; `ends` are the last periods of the drives in it."""
    count = sum(sum(copy.sink.counts.values()) for copy in copies)
    times = [copy.sink.times for copy in copies if copy.sink.chunks]
    first, last = min(begin for begin, _ in times), max(end for _, end in times)
    text = f"{path}: saved {count} messages from {first * 1e-9:.4f} to {last * 1e-9:.4f} s"
    if len(ends) == 1:
        text += f"; all topics of the loop end at period {ends[0]}"
    damaged = sum(copy.damaged for copy in copies)
    if damaged:
        text += f"; {damaged} damaged part{'s' * (damaged > 1)} dropped"
    ragged = sum(copy.ragged for copy in copies)
    if ragged:
        text += (
            f"; {ragged} message{'s' * (ragged > 1)} behind the last period that all topics have "
            "left out"
        )
    kept = [copy.kept.name for copy in copies if copy.kept is not None]
    if kept:
        files = "the old file is" if len(kept) == 1 else "the old files are"
        text += f"; {files} kept as {', '.join(kept)}"
    return text

"""
Repairing a recording whose writer was killed, or whose file was damaged.

All whole chunks are copied into a new file, which is finished as a writer would have done it and
then takes the place of the old one. A chunk whose checksum does not match is dropped, never
guessed. Where something had to be dropped from within the file, the old one stays beside the new
one as ``*.damaged``.
"""

from __future__ import annotations

import os
import shutil
import struct
from array import array
from contextlib import suppress
from pathlib import Path

from mcap.opcode import Opcode

from mfpcc_experiments.bags import mcap_file
from mfpcc_experiments.bags.bag import (
    CHUNK_BYTES,
    CONFIG_RECORD,
    SUMMARY_RECORD,
    BagError,
    McapSink,
    encode,
    finish_bag,
    json_record,
)
from mfpcc_experiments.bags.recording import bag_files

_OWN_RECORDS = ("rosbag2", SUMMARY_RECORD)  # written anew


def recover(path: Path) -> str:
    """
    Repair a recording in place.

    Parameters
    ----------
    path : Path
        Folder of a bag, or its MCAP file.

    Returns
    -------
    str
        What was saved, in a sentence.

    Raises
    ------
    BagError
        If there is nothing to save, or the file cannot be read or written.
    """
    path = Path(path)
    files = bag_files(path)
    if len(files) > 1:
        raise BagError(f"{path}: holds {len(files)} files; give one of them, e.g. {files[0]}")
    file = files[0]
    if file.suffix != ".mcap":
        raise BagError(f"{file}: only MCAP recordings can be repaired")
    alone = len(list(file.parent.glob("*.mcap"))) == 1
    workshop = file.parent / ".recover"
    try:
        shutil.rmtree(workshop, ignore_errors=True)  # of an attempt that was killed
        workshop.mkdir()
        try:
            copy = _Copy(file, workshop / file.name)
            copy.run()
            if copy.problem is None and (not alone or (file.parent / "metadata.yaml").exists()):
                return f"{path}: whole, nothing to repair"
            if not copy.sink.chunks:
                raise BagError(
                    f"{path}: nothing to save: the file holds no whole chunk of messages"
                )
            copy.finish()
            if copy.damaged:
                os.replace(file, file.with_name(file.name + ".damaged"))
            os.replace(workshop / file.name, file)
            if alone:
                os.replace(workshop / "metadata.yaml", file.parent / "metadata.yaml")
        finally:
            shutil.rmtree(workshop, ignore_errors=True)
    except OSError as error:
        raise BagError(f"{error.filename or path}: {error.strerror}") from None
    return copy.report(path)


class _Copy:
    """The whole parts of `source`, copied to `target`."""

    def __init__(self, source: Path, target: Path) -> None:
        self.source = source
        self.sink = McapSink(target)
        self.problem: BagError | None = None
        self.damaged = 0
        self._summary: dict[str, object] = {}
        self._custom: dict[str, str] = {}
        self._channels = mcap_file.Channels(source)
        # The chunk that says what the channels are may be the damaged one; the summary says it too.
        with suppress(mcap_file.DamagedError):
            for record in mcap_file.summary(source):
                self._channels.see(record.opcode, record.content)
        self._sent: set[int] = set()
        # Messages that lie outside of chunks, until there are enough for one.
        self._loose = bytearray()

    def run(self) -> None:
        """Copy until the end of the file, or of what can be read of it."""
        try:
            for record in mcap_file.records(self.source):
                try:
                    self._record(record)
                except mcap_file.DamagedError as error:
                    self.problem = error
                    self.damaged += 1
        except (mcap_file.UnfinishedError, mcap_file.DamagedError) as error:
            self.problem = self.problem or error
            if isinstance(error, mcap_file.DamagedError) and not self.damaged:
                self.damaged = 1
        self._flush()

    def _record(self, record: mcap_file.Record) -> None:
        if record.opcode == 6:
            self._flush()
            self._chunk(mcap_file.unpack_chunk(record.content, self.source))
        elif record.opcode == 5:
            self._loose += struct.pack("<BQ", 5, len(record.content)) + record.content
            if len(self._loose) > CHUNK_BYTES // 4:
                self._flush()
        elif record.opcode == 12:
            name, value = mcap_file.metadata(record, self.source)
            if name == SUMMARY_RECORD and isinstance(value, dict):
                self._summary = value
            if name == CONFIG_RECORD and isinstance(value, dict):
                self._custom = {
                    key: str(value[key])
                    for key in ("experiment", "scheme", "motor", "engine", "seed")
                    if value.get(key) is not None
                }
                self.sink.metadata(name, json_record(value))
            elif name not in _OWN_RECORDS and isinstance(value, dict):
                self.sink.metadata(name, {k: str(v) for k, v in value.items()})
        else:
            self._channels.see(record.opcode, record.content)

    def _flush(self) -> None:
        if self._loose:
            data, self._loose = bytes(self._loose), bytearray()
            self._chunk(data)

    def _chunk(self, data: bytes) -> None:
        """Copy one chunk; its index is made anew."""
        messages: list[tuple[int, int, int]] = []
        there = set(self._sent)
        for opcode, begin, end, channel_id, log_time in mcap_file.split(data, self.source):
            if opcode == 5:
                self._channels.topic(channel_id)  # known, or the chunk is of no use
                messages.append((channel_id, log_time, begin - 31))
            else:
                self._channels.see(opcode, data[begin:end])
                if opcode == Opcode.CHANNEL:
                    there.add(int.from_bytes(data[begin : begin + 2], "little"))
        # What a dropped chunk said of its channels is said again.
        head = b"".join(
            self._description(channel_id)
            for channel_id in sorted({channel_id for channel_id, _, _ in messages} - there)
        )
        index: dict[int, array[int]] = {}
        for channel_id, log_time, offset in messages:
            index.setdefault(channel_id, array("Q")).extend((log_time, offset + len(head)))
        # Every channel of the summary must be known to the sink before it counts messages of it.
        for channel_id in index:
            channel = self._channels.channels[channel_id]
            self.sink.channels[channel_id] = channel
            if channel.schema_id in self._channels.schemas:
                self.sink.schemas[channel.schema_id] = self._channels.schemas[channel.schema_id]
        self.sink.chunk(head + data, index)
        self._sent = there | set(index)

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
        finish_bag(self.sink, self._summary, self._custom)

    def report(self, path: Path) -> str:
        """What was saved, in a sentence."""
        count = sum(self.sink.counts.values())
        first, last = self.sink.times
        text = f"{path}: saved {count} messages from {first * 1e-9:.4f} to {last * 1e-9:.4f} s"
        if self.damaged:
            text += (
                f"; {self.damaged} damaged part{'s' * (self.damaged > 1)} dropped, the old file is "
                f"kept as {self.source.name}.damaged"
            )
        return text

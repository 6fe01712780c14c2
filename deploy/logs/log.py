"""Write and read the log of a run: MCAP with JSON messages, readable after any end.

The same run gives the same bytes: chunks end where the run's own time says, nothing carries the wall clock unless the
run itself lives by it. A chunk is closed about every second and when the log is closed, so a killed process loses a
second at most.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from controller.errors import InputError, RunError
from controller.rig import Rig
from controller.rig_file import parse_rig
from deploy.logs.log_topics import FORMAT, TOPICS

_FLUSH_S: Final = 1.0
_CHUNK_BYTES: Final = 1 << 20
_LIBRARY: Final = "servolve"
_MAGIC: Final = b"\x89MCAP"
_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True)
class Log:
    """Hold what a log says.

    Args:
        path: the file
        messages: topic => its messages, in the order they were written
        complete: whether the file was closed properly
    """

    path: Path
    messages: Mapping[str, tuple[Mapping[str, Any], ...]]
    complete: bool

    @property
    def meta(self) -> Mapping[str, Any]:
        """Return the run's description."""
        return self.messages["/meta"][0]

    @property
    def cycles(self) -> tuple[Mapping[str, Any], ...]:
        """Return the control periods."""
        return self.messages.get("/cycle", ())

    @property
    def events(self) -> tuple[Mapping[str, Any], ...]:
        """Return changes of state, faults and warnings."""
        return self.messages.get("/event", ())


class RunLog:
    """Write a log; close it on every way out.

    Args:
        path: the file; a log that is there is overwritten, anything else is not
        epoch_ns: wall-clock time of t = 0 [ns]; 0 in lock step, where no wall clock may enter

    Raises:
        InputError: if the file can not be written, or is something else than a log
    """

    def __init__(self, path: str | Path, epoch_ns: int = 0) -> None:
        self.path = Path(path)
        self._epoch_ns = epoch_ns
        self._flushed_at = 0.0
        self._failed = False
        check_log_path(self.path)
        try:
            self._file = self.path.open("wb")
        except OSError as error:
            raise InputError(f"{path}: the log cannot be written there ({error.strerror}); name another file") from None
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=_LIBRARY)
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        for name, topic in TOPICS.items():
            schema = self._writer.register_schema(topic.schema, "jsonschema", topic.json_schema())
            self._channels[name] = self._writer.register_channel(name, "json", schema)
            self._counts[name] = 0

    def write(self, topic: str, t: float, message: Mapping[str, Any]) -> None:
        """Write one message.

        Args:
            topic: a name of `TOPICS`
            t: since the start of the run [s]; becomes the message's first field
            message: its other fields

        Raises:
            RunError: the first time that the file can not be written; later messages are dropped in silence, so that
                nothing keeps the caller from ending in order
        """
        if self._failed:
            return
        data = json.dumps({"t": round(t, 9), **message}, separators=(",", ":"), allow_nan=False).encode()
        time_ns = self._epoch_ns + max(0, round(t * 1e9))
        self._counts[topic] += 1
        try:
            self._writer.add_message(self._channels[topic], time_ns, data, time_ns, self._counts[topic])
            if t >= self._flushed_at + _FLUSH_S:
                self._flushed_at = t
                self._writer.flush()
        except OSError as error:
            raise self._failure(error) from None

    def close(self) -> None:
        """Finish the file.

        Raises:
            RunError: if it can not be written and nothing has said so yet
        """
        if self._file.closed:
            return
        try:
            if not self._failed:
                self._writer.finish()
            self._file.close()
        except OSError as error:
            raise self._failure(error) from None

    def _failure(self, error: OSError) -> RunError:
        self._failed = True
        return RunError(f"{self.path}: the log cannot be written any more ({error.strerror}); make room on the disk")

    def __enter__(self) -> RunLog:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Finish the file."""
        self.close()


def check_log_path(path: Path) -> None:
    """Refuse what can be no log's place, and a recording, a controller or whatever else stands there.

    Args:
        path: where a log shall be written

    Raises:
        InputError: a log can not be written there, or would overwrite what nobody can bring back
    """
    why = "it is a folder" if path.is_dir() else "its folder is not there" if not path.parent.is_dir() else ""
    try:
        begins = b""
        if path.is_file():
            with path.open("rb") as file:
                begins = file.read(len(_MAGIC))
    except OSError as error:
        why = str(error.strerror)
    if why:
        raise InputError(f"{path}: the log cannot be written there ({why}); name another file")
    if not _MAGIC.startswith(begins):
        raise InputError(f"{path}: is there and is no log, so it is not overwritten; name another file")


def read_log(path: str | Path) -> Log:
    """Read a log, as far as it was written.

    Args:
        path: the file

    Returns:
        its messages; those of a chunk that a killed process left incomplete are missing

    Raises:
        InputError: if it can not be read, or is not a log of servolve
    """
    messages: dict[str, list[Mapping[str, Any]]] = {}
    complete = False
    try:
        with Path(path).open("rb") as file:
            topics: dict[int, str] = {}
            for record in _records(StreamReader(file, validate_crcs=True), path):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    messages.setdefault(topics[record.channel_id], []).append(json.loads(record.data))
                elif isinstance(record, Footer):
                    complete = True
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a log") from None
    except InputError:
        raise
    except Exception as error:  # what a decoder raises over damaged bytes is its own affair
        raise InputError(f"{path}: is damaged ({error}); record the run again") from None
    meta = messages.get("/meta", [{}])[0]
    if meta.get("format") != FORMAT:
        raise InputError(
            f"{path}: has no /meta of format {FORMAT}, so it is not a log of this servolve; record it anew"
        )
    return Log(Path(path), {topic: tuple(all_of) for topic, all_of in messages.items()}, complete)


def _records(reader: StreamReader, path: str | Path) -> Iterator[object]:
    records = reader.records
    started = False
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except (McapError, struct.error) as error:
            if not started:
                raise InputError(
                    f"{path}: is not an MCAP file ({type(error).__name__}); give the path of a log"
                ) from None
            return  # the end of an unfinished file
        started = True
        yield record


def log_text(log: Log, field: str) -> str:
    """Return a text that the run's description embeds.

    Args:
        log: the log
        field: "rig_text" or "controller_text"

    Raises:
        RunError: if it is missing
    """
    text = log.meta.get(field)
    if not isinstance(text, str) or not text:
        raise RunError(
            f"{log.path}: /meta has no {field}, so the run cannot be replayed; record it with servolve deploy"
        )
    return text


def log_rig(log: Log, folder: Path | None = None) -> Rig:
    """Return the rig that the run's description embeds.

    Args:
        log: the log
        folder: where the rig's body may stand; None: beside the log

    Raises:
        InputError: if it is no rig
        RunError: if it is missing
    """
    name = log.meta.get("rig")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(f"{log.path}: /meta names a rig {name!r}, which can be no rig's name; record the run again")
    text = log_text(log, "rig_text")
    try:
        return parse_rig(text, (folder or log.path.parent) / f"{name}.rig.toml")
    except InputError as error:
        raise InputError(f"{log.path}: /meta rig_text: {error}") from None

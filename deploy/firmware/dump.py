"""Turn a recorded console stream into the log of one of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from controller.controller import Controller
from controller.rig import Rig
from deploy.firmware.console_decoder import ConsoleDecoder, Damaged, Text
from deploy.firmware.records import Cycle, End, Hello, Record, Started
from deploy.firmware.run_log import RecordLog, Write, shape_of
from deploy.host_loop import Outcome

LABEL = "the board's bus"


@dataclass(frozen=True)
class DumpedRun:
    """Hold one run of a console stream.

    Args:
        hello: of the boot before it, or None if it was not recorded
        started: what was asked for, or None if that was lost
        records: of the run, from there on
        complete: whether its end was recorded
    """

    hello: Hello | None
    started: Started | None
    records: tuple[Record, ...]
    complete: bool


def dumped_runs(data: bytes, rig: Rig, controller: Controller) -> tuple[list[DumpedRun], int]:
    """Find the runs in what a board's console has sent.

    Args:
        data: as it came, or part of it
        rig: the rig
        controller: the controller

    Returns:
        the runs, and how many pieces of the stream were damaged
    """
    decoder = ConsoleDecoder(shape_of(rig, controller))
    pieces = [*decoder.feed(data), *decoder.end()]
    damaged = sum(isinstance(piece, Damaged) for piece in pieces)
    runs: list[DumpedRun] = []
    hello: Hello | None = None
    part: list[Record] = []
    for piece in pieces:
        if isinstance(piece, (Text, Damaged)):
            continue
        if isinstance(piece, (Hello, Started)) and part:
            runs.append(_run(hello, part))
            part = []
        if isinstance(piece, Hello):
            hello = piece
            continue
        part.append(piece)
        if isinstance(piece, End):
            runs.append(_run(hello, part))
            part = []
    if part:
        runs.append(_run(hello, part))
    return runs, damaged


def write_run(run: DumpedRun, rig: Rig, controller: Controller, write: Write) -> Outcome:
    """Write a run's messages.

    Args:
        run: the run
        rig: the rig
        controller: the controller
        write: takes the messages; `/meta` is there already

    Returns:
        how the run went, as far as it was recorded
    """
    log = RecordLog(rig, controller, LABEL, write)
    for record in run.records:
        log.hear(record)
    if not run.complete:
        log.outcome.state = log.state
    return log.outcome


def lost_cycles(records: Sequence[Record]) -> int:
    """Return how many control periods are missing between the first and the last that were recorded.

    Args:
        records: of one run
    """
    numbers = [record.k for record in records if isinstance(record, Cycle)]
    return numbers[-1] + 1 - len(numbers) if numbers else 0


def _run(hello: Hello | None, part: Sequence[Record]) -> DumpedRun:
    started = part[0] if isinstance(part[0], Started) else None
    return DumpedRun(hello, started, tuple(part), isinstance(part[-1], End))

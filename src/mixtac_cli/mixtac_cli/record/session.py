# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: listen, check, write a bag, and report the losses."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from mixtac_cli.doctor import table
from mixtac_cli.options import JsonFile, Namespace
from mixtac_cli.record.checks import (
    check_clocks,
    check_disk,
    check_topics,
    free_bytes,
    progress_table,
)
from mixtac_cli.record.meter import RecordingSummary
from mixtac_cli.record.recorder_node import Listener, running_listener
from mixtac_driver.doctor.computer import Finding, Level
from mixtac_node.files import write_json
from mixtac_node.topics import DEFAULT_NAMESPACE, EVENTS, REFERENCE
from mixtac_recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_recordings.recording import RecordingError

DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost."""
REFRESH_S = 0.5
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[
        float, typer.Option(min=0, help='Length of the recording (s); 0 records until Ctrl-C.')
    ] = 0,
    namespace: Namespace = DEFAULT_NAMESPACE,
    reference_topic: Annotated[
        str, typer.Option(help='Topic of the reference force (WrenchStamped).')
    ] = REFERENCE,
    profile: Annotated[
        str, typer.Option(help='Kind of motion, for dataset.yaml, for example static.')
    ] = '',
    split: Annotated[str, typer.Option(help='train or test, for dataset.yaml.')] = '',
    check: Annotated[
        bool, typer.Option('--check', help='Only check the sensor; record nothing.')
    ] = False,
    check_seconds: Annotated[
        float, typer.Option(min=0.5, help='How long the checks listen (s).')
    ] = 2,
    wait: Annotated[
        float, typer.Option(min=0, help='Longest time to wait for the first event packet (s).')
    ] = 0,
    force: Annotated[
        bool, typer.Option('--force', help='Record even if the checks find errors.')
    ] = False,
    json: JsonFile = None,
) -> None:
    """Check disk, topics and clocks, record the running sensor, and report the losses."""
    if split not in {'', 'train', 'test'}:
        raise typer.BadParameter(f'{split!r}: choose train or test', param_hint='--split')
    if out.exists():
        raise RecordingError(f'{out} exists', remedy='name a new folder')
    read_recordings(out.absolute().parent / FILE_NAME)
    console = Console()
    with running_listener(namespace) as listener, _noted_signals() as stopping:
        listener.listen(reference_topic)
        _wait_for_packet(console, listener, wait, stopping)
        findings = _check(console, listener, out, seconds, check_seconds, stopping)
        errors = [each for each in findings if each.level is Level.ERROR]
        if errors and not force:
            first = '; '.join(filter(None, (errors[0].found, errors[0].remedy)))
            raise RecordingError(f'not recorded: {errors[0].name}: {first}; --force records anyway')
        if check or stopping():
            return
        summary = _record(console, listener, out, seconds, stopping)
    path = add_recording(out, summary.as_dict(), profile=profile, split=split)
    console.print(f'{out}: {summary.seconds:.1f} s, {summary.verdict()}')
    console.print(f'described in {path}')
    if json is not None:
        write_json(json, summary.as_dict())
    if summary.stopped:
        raise RecordingError(
            f'{out} ends early: {summary.stopped}', remedy='free some space for the next one'
        )


@contextlib.contextmanager
def _noted_signals() -> Iterator[Callable[[], bool]]:
    """Note the signals that end a recording, so that its bag is closed; yield whether one came."""
    noted: list[int] = []
    before = [signal.signal(number, lambda got, _: noted.append(got)) for number in SIGNALS]
    try:
        yield lambda: bool(noted)
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


def _wait_for_packet(
    console: Console, listener: Listener, seconds: float, stopping: Callable[[], bool]
) -> None:
    """Wait until an event packet has arrived, for at most some seconds."""
    events = next(meter for meter in listener.meters if meter.topic.name == EVENTS.name)
    end_s = time.monotonic() + seconds
    with console.status('waiting for the first event packet'):
        while not events.messages and time.monotonic() < end_s and not stopping():
            listener.spin_for(REFRESH_S, stopping)


def _check(
    console: Console,
    listener: Listener,
    out: Path,
    seconds: float,
    check_seconds: float,
    stopping: Callable[[], bool],
) -> list[Finding]:
    """Listen and print the findings; nothing if interrupted."""
    with console.status('listening'):
        listener.spin_for(DISCOVERY_S, stopping)
        for meter in listener.meters:
            meter.restart()
        began_s = time.monotonic()
        listener.spin_for(check_seconds, stopping)
        elapsed_s = time.monotonic() - began_s
    if stopping():
        return []
    bytes_per_s = sum(meter.size for meter in listener.meters) / elapsed_s
    simulated = listener.count_publishers('/clock') > 0
    findings = [
        check_disk(free_bytes(out), bytes_per_s, seconds),
        *check_clocks(time.time_ns(), listener.stamps_ns(), simulated_time=simulated),
        *check_topics(listener.meters, listener.publishers(), elapsed_s),
    ]
    console.print(table('before recording', findings))
    return findings


def _record(
    console: Console, listener: Listener, out: Path, seconds: float, stopping: Callable[[], bool]
) -> RecordingSummary:
    """Record until the time is over, a signal comes, or the disk fails."""
    listener.start(out)
    began_s = time.monotonic()
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not stopping() and not (listener.writer and listener.writer.failure):
            left_s = seconds - (time.monotonic() - began_s)
            if seconds and left_s <= 0:
                break
            listener.spin_for(min(left_s, REFRESH_S) if seconds else REFRESH_S, stopping)
            live.update(_progress(listener, out, time.monotonic() - began_s), refresh=True)
    console.print(_progress(listener, out, time.monotonic() - began_s))
    summary = listener.finish()
    assert summary is not None  # noqa: S101  (started above)
    return summary


def _progress(listener: Listener, out: Path, elapsed_s: float) -> Table:
    return progress_table(
        listener.meters,
        f'{out}, {elapsed_s:.0f} s; press Ctrl-C to stop',
        dropped=listener.writer.dropped if listener.writer else 0,
        disk_bytes=free_bytes(out),
    )

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: wait for the sensor, write a bag, and report the losses."""

from __future__ import annotations

import contextlib
import math
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from mixtac.figures import make_table
from mixtac.meter import RecordingSummary
from mixtac.options import JsonFile, Namespace, Split, check_topic
from mixtac.recorder_node import Listener
from mixtac_core.node.files import write_json
from mixtac_core.node.topics import DEFAULT_NAMESPACE, EVENTS, REFERENCE
from mixtac_core.recordings.bag import check_new
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.recording import RecordingError

DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost [s]."""
REFRESH_S = 0.5
"""Period of the display [s]."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
RESERVE_BYTES = 1 << 30
"""Least free space to begin with [bytes]."""


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[
        float, typer.Option(min=0, help='Length of the recording (s); 0 records until Ctrl-C.')
    ] = 0,
    namespace: Namespace = DEFAULT_NAMESPACE,
    reference_topic: Annotated[
        str,
        typer.Option(help='Topic of the reference force (WrenchStamped).', callback=check_topic),
    ] = REFERENCE,
    profile: Annotated[
        str, typer.Option(help='Kind of motion, for dataset.yaml, for example static.')
    ] = '',
    split: Split = '',
    check: Annotated[
        bool, typer.Option('--check', help='Only wait for event packets; record nothing.')
    ] = False,
    wait: Annotated[
        float, typer.Option(min=0, help='Longest time to wait for the first event packet (s).')
    ] = 5,
    json: JsonFile = None,
) -> None:
    """Record the running sensor, and report the losses. `mixtac doctor` checks the sensor."""
    check_new(out)
    read_recordings(out.absolute().parent / FILE_NAME)
    if free_bytes(out) < RESERVE_BYTES:
        raise RecordingError(
            f'{free_bytes(out) / 1e9:.1f} GB are free for {out}',
            remedy='free space or choose another disk',
        )
    console = Console(markup=False)
    with Listener.opened('record', namespace) as listener, _noted_signals() as stopping:
        listener.listen(reference_topic)
        _wait_for_packet(console, listener, wait, stopping)
        if check or stopping():
            return
        summary = _record(console, listener, out, seconds, stopping)
        path = add_recording(out, summary.as_dict(), profile=profile, split=split)
    console.print(f'{out}: {summary.seconds:.1f} s, {summary.verdict()}')
    console.print(f'described in {path}')
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
    """Wait until event packets arrive.

    Raises:
        RecordingError: None came in time.
    """
    events = next(meter for meter in listener.meters if meter.topic.name == EVENTS.name)
    end_s = time.monotonic() + DISCOVERY_S + seconds
    with console.status('waiting for event packets'):
        listener.spin_for(DISCOVERY_S, stopping)
        while not events.messages and not stopping():
            if time.monotonic() > end_s:
                raise RecordingError(
                    f'no event packets on {events.topic.resolved(listener.get_namespace())}',
                    remedy='start the sensor, or give its --namespace; `mixtac doctor` checks it',
                )
            listener.spin_for(REFRESH_S, stopping)


def _record(
    console: Console, listener: Listener, out: Path, seconds: float, stopping: Callable[[], bool]
) -> RecordingSummary:
    """Record until the time is over, a signal comes, or the disk fails."""
    listener.start(out)
    began_s = time.monotonic()
    end_s = began_s + (seconds or math.inf)
    with Live(console=console, auto_refresh=False) as live:
        while not stopping() and not (listener.writer and listener.writer.failure):
            if (left_s := end_s - time.monotonic()) <= 0.0:
                break
            listener.spin_for(min(left_s, REFRESH_S), stopping)
            live.update(_progress(listener, out, time.monotonic() - began_s), refresh=True)
    summary = listener.finish()
    assert summary is not None  # noqa: S101  (started above)
    return summary


def _progress(listener: Listener, out: Path, elapsed_s: float) -> Table:
    """Return the state of a recording; topics without messages are left out."""
    size = sum(meter.size for meter in listener.meters)
    dropped = listener.writer.dropped if listener.writer else 0
    rows = [
        (
            *(meter.topic.name, meter.messages, f'{meter.rate_hz:.1f}'),
            *(f'{1e-9 * meter.longest_gap_ns:.3f}', f'{meter.size / 1e6:.2f}', meter.missing),
        )
        for meter in listener.meters
        if meter.messages
    ]
    title = f'{out}, {elapsed_s:.0f} s; press Ctrl-C to stop'
    table = make_table(title, ('topic', 'messages', 'Hz', 'longest gap (s)', 'MB', 'lost'), rows)
    table.caption = (
        f'{size / 1e6:.1f} MB, {free_bytes(out) / 1e9:.1f} GB left on the disk, '
        f'{dropped} messages dropped'
    )
    return table


def free_bytes(path: Path) -> int:
    """Return the free space on the disk of a folder, which need not exist yet [bytes]."""
    existing = next(each for each in (path, *path.absolute().parents) if each.exists())
    return shutil.disk_usage(existing).free

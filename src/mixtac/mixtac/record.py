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
from mixtac.options import Namespace, Profile, ReferenceTopic, Split
from mixtac.recorder_node import Listener, verdict
from mixtac_core.node.topics import DEFAULT_NAMESPACE, EVENTS, REFERENCE
from mixtac_core.recordings.bag import check_new
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.recording import RecordingError

DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost [s]."""
REFRESH_S = 0.5
"""Period of the display [s]."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[
        float, typer.Option(min=0, help='Length of the recording (s); 0 records until Ctrl-C.')
    ] = 0,
    namespace: Namespace = DEFAULT_NAMESPACE,
    reference: ReferenceTopic = REFERENCE,
    profile: Profile = '',
    split: Split = '',
    wait: Annotated[
        float, typer.Option(min=0, help='Longest time to wait for the first event packet (s).')
    ] = 5,
) -> None:
    """Record the running sensor, and report the losses. `mixtac doctor` checks the sensor."""
    check_new(out)
    read_recordings(out.absolute().parent / FILE_NAME)
    console = Console(markup=False)
    with Listener.opened('record', namespace) as listener, _noted_signals() as stopping:
        listener.listen(reference)
        _wait_for_packet(console, listener, wait, stopping)
        if stopping():
            return
        listener.start(out)
        _show(console, listener, out, seconds or math.inf, stopping)
        figures = listener.finish()
        assert figures is not None  # noqa: S101  (started above)
        path = add_recording(out, figures, profile=profile, split=split)
    console.print(f'{out}: {verdict(figures)}')
    console.print(f'described in {path}')
    if figures['stopped']:
        raise RecordingError(
            f'{out} ends early: {figures["stopped"]}', remedy='free some space for the next one'
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
    with console.status('waiting for event packets'):
        listener.spin_for(DISCOVERY_S, stopping)
        listener.spin_for(seconds, lambda: stopping() or events.messages > 0)
    if not events.messages and not stopping():
        raise RecordingError(
            f'no event packets on {events.topic.resolved(listener.get_namespace())}',
            remedy='start the sensor, or give its --namespace; `mixtac doctor` checks it',
        )


def _show(
    console: Console, listener: Listener, out: Path, seconds: float, stopping: Callable[[], bool]
) -> None:
    """Record until the time is over, a signal comes, or the disk fails; show the progress."""
    began_s = time.monotonic()
    with Live(console=console, auto_refresh=False) as live:
        while not stopping() and not (listener.writer and listener.writer.failure):
            elapsed_s = time.monotonic() - began_s
            if elapsed_s >= seconds:
                break
            listener.spin_for(min(seconds - elapsed_s, REFRESH_S), stopping)
            live.update(_progress(listener, out, elapsed_s), refresh=True)


def _progress(listener: Listener, out: Path, elapsed_s: float) -> Table:
    """Return the state of a recording; topics without messages are left out."""
    rows = [
        (
            m.topic.name,
            m.messages,
            f'{m.rate_hz:.1f}',
            f'{1e-9 * m.longest_gap_ns:.3f}',
            f'{m.size / 1e6:.2f}',
            m.missing,
        )
        for m in listener.meters
        if m.messages
    ]
    title = f'{out}, {elapsed_s:.0f} s; press Ctrl-C to stop'
    table = make_table(title, ('topic', 'messages', 'Hz', 'longest gap (s)', 'MB', 'lost'), rows)
    table.caption = f'{shutil.disk_usage(out).free / 1e9:.1f} GB left on the disk'
    return table

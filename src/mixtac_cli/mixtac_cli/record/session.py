# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: listen, check disk, topics and clocks, write a bag, and report the losses."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TextIO, cast

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from mixtac_cli.doctor import table
from mixtac_cli.options import JsonFile, Namespace, Split, check_topic
from mixtac_cli.record.meter import RecordingSummary, TopicMeter
from mixtac_cli.record.recorder_node import Listener
from mixtac_driver.doctor import Finding, Level, ok
from mixtac_node import topics
from mixtac_node.files import write_json
from mixtac_node.topics import DEFAULT_NAMESPACE, EVENTS, REFERENCE
from mixtac_recordings.bag import check_new
from mixtac_recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_recordings.recording import RecordingError

DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost."""
REFRESH_S = 0.5
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
REQUIRED = ('events', 'image_raw')
LEAST_HZ = {'events': 990.0, 'image_raw': 5.0, 'force': 490.0, topics.IMU.name: 50.0}
"""Smallest expected rates [Hz]: packets every 1 ms, windows of 2 ms."""
RESERVE_BYTES = 1 << 30
SHORT_BYTES = 10 << 30
EARLIEST_NS = 1_577_836_800_000_000_000
"""2020: an earlier host clock was never set."""
MOST_CLOCK_OFFSET_S = 1.0


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
    check_new(out)
    read_recordings(out.absolute().parent / FILE_NAME)
    console = Console(file=cast('TextIO', Display(sys.stdout)), markup=False)
    with Listener.opened('record', namespace) as listener, _noted_signals() as stopping:
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
    write_json(json, summary.as_dict())
    if summary.stopped:
        raise RecordingError(
            f'{out} ends early: {summary.stopped}', remedy='free some space for the next one'
        )


class Display:
    """A stream of text that may break, with its terminal or its pipe: the rest goes nowhere then.

    Args:
        stream: The stream, of a file descriptor of its own.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Return what else the stream has."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        with self._broken_is_silent():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Show what was written."""
        with self._broken_is_silent():
            self._stream.flush()

    @contextlib.contextmanager
    def _broken_is_silent(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            # What is still buffered, also at the end of the process, must go somewhere.
            with Path(os.devnull).open('wb') as nowhere:
                os.dup2(nowhere.fileno(), self._stream.fileno())


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
    """Return the state of a recording; topics without messages are left out."""
    size = sum(meter.size for meter in listener.meters)
    dropped = listener.writer.dropped if listener.writer else 0
    table = Table(
        title=f'{out}, {elapsed_s:.0f} s; press Ctrl-C to stop',
        title_justify='left',
        caption=f'{size / 1e6:.1f} MB, {free_bytes(out) / 1e9:.1f} GB left on the disk, '
        f'{dropped} messages dropped',
        caption_justify='left',
    )
    table.add_column('topic')
    for heading in ('messages', 'Hz', 'MB', 'lost'):
        table.add_column(heading, justify='right')
    for meter in listener.meters:
        if meter.messages:
            table.add_row(
                meter.topic.name,
                str(meter.messages),
                f'{meter.rate_hz:.1f}',
                f'{meter.size / 1e6:.2f}',
                str(meter.missing),
                style='yellow' if meter.missing else None,
            )
    return table


def check_disk(free_bytes: int, bytes_per_s: float, seconds: float) -> Finding:
    """Check that a recording fits.

    Args:
        free_bytes: Free on the disk of the bag.
        bytes_per_s: Rate at which messages arrive now.
        seconds: Planned length [s]; 0 for until stopped.
    """
    left_s = max(0.0, free_bytes - RESERVE_BYTES) / bytes_per_s if bytes_per_s else float('inf')
    room = f'{free_bytes / 1e9:.1f} GB free, {bytes_per_s / 1e6:.1f} MB/s'
    if free_bytes <= RESERVE_BYTES or left_s < seconds:
        found = f'{room}: full in {left_s:.0f} s'
        return Finding('disk', Level.ERROR, found, 'free space or choose another disk')
    if not seconds and free_bytes < SHORT_BYTES:
        return Finding('disk', Level.WARN, f'{room}: enough for {left_s:.0f} s')
    return ok('disk', room)


def free_bytes(path: Path) -> int:
    """Return the free space on the disk of a folder, which need not exist yet [bytes]."""
    existing = next(each for each in (path, *path.absolute().parents) if each.exists())
    return shutil.disk_usage(existing).free


def check_topics(
    meters: Sequence[TopicMeter], publishers: Mapping[str, int], seconds: float
) -> list[Finding]:
    """Check that published topics arrive at their rates.

    Args:
        meters: Meters of the topics.
        publishers: Publishers by name of the topic.
        seconds: Listening time [s].
    """
    return [
        finding
        for meter in meters
        if (finding := _check_topic(meter, publishers.get(meter.topic.name, 0), seconds))
    ]


def _check_topic(meter: TopicMeter, publishers: int, seconds: float) -> Finding | None:
    name, required = meter.topic.name, meter.topic.name in REQUIRED
    if publishers == 0:
        text = 'no publisher: start the sensor, or give its --namespace'
        return Finding(name, Level.ERROR, text) if required else None
    if publishers > 1 and name != '/diagnostics':
        text = f'{publishers} publishers: two sensors share a namespace; stop one of them'
        return Finding(name, Level.ERROR, text)
    if meter.messages == 0:
        text = 'published, but nothing arrived'
        least = LEAST_HZ.get(name)
        return Finding(name, Level.ERROR if required else Level.WARN, text) if least else None
    rate_hz = meter.messages / seconds
    if rate_hz < LEAST_HZ.get(name, 0.0):
        text = f'{rate_hz:.0f} Hz, at least {LEAST_HZ[name]:.0f} Hz expected; see /diagnostics'
        return Finding(name, Level.WARN, text)
    if meter.missing:
        text = f'{rate_hz:.0f} Hz, {meter.missing} messages lost: this computer is too busy'
        return Finding(name, Level.WARN, text)
    return ok(name, f'{rate_hz:.1f} Hz')


def check_clocks(
    now_ns: int, stamps_ns: Mapping[str, int], *, simulated_time: bool = False
) -> list[Finding]:
    """Check that clocks are set and that those of one kind agree.

    Args:
        now_ns: Host clock [ns since the Unix epoch].
        stamps_ns: Latest stamp of each topic on the camera clock, by name [ns].
        simulated_time: Whether `/clock` has a publisher.
    """
    findings = []
    if now_ns < EARLIEST_NS:
        findings.append(Finding('host clock', Level.ERROR, 'never set: set it, or run NTP'))
    if simulated_time:
        text = '/clock is published: the stamps are those of a recording or simulator'
        findings.append(Finding('host clock', Level.WARN, text))
    offsets_s = {name: (now_ns - stamp) / 1e9 for name, stamp in stamps_ns.items() if stamp}
    if not offsets_s:
        return findings
    apart_s = max(offsets_s.values()) - min(offsets_s.values())
    if apart_s > MOST_CLOCK_OFFSET_S:
        early = max(offsets_s, key=lambda name: offsets_s[name])
        late = min(offsets_s, key=lambda name: offsets_s[name])
        text = (
            f'{early} lies {apart_s:.1f} s behind {late}: they are not from one camera, or the'
            ' computer does not keep up'
        )
        findings.append(Finding('camera clock', Level.ERROR, text))
    worst_s = max(offsets_s.values(), key=abs)
    if abs(worst_s) > MOST_CLOCK_OFFSET_S and not simulated_time:
        text = f'stamps are {worst_s:+.1f} s from the host: a recording, or a changed host clock'
        findings.append(Finding('camera clock', Level.WARN, text))
    elif apart_s <= MOST_CLOCK_OFFSET_S:
        findings.append(ok('camera clock', f'{1e3 * worst_s:+.0f} ms from the host'))
    return findings

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of disk, topics and clocks before a recording, and the table shown during it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from mixtac_cli.record.meter import TopicMeter
from mixtac_driver.doctor.computer import Finding, Level, ok

REQUIRED = ('events', 'image_raw')
LEAST_HZ = {'events': 990.0, 'image_raw': 5.0, 'force': 490.0, 'imu': 50.0}
"""Smallest expected rates [Hz]: packets every 1 ms, windows of 2 ms."""
RESERVE_BYTES = 1 << 30
SHORT_BYTES = 10 << 30
EARLIEST_NS = 1_577_836_800_000_000_000
"""2020: an earlier host clock was never set."""
MOST_CLOCK_OFFSET_S = 1.0


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
        text = f'{early} lies {apart_s:.1f} s behind {late}: they are not from one camera'
        findings.append(Finding('camera clock', Level.ERROR, text))
    worst_s = max(offsets_s.values(), key=abs)
    if abs(worst_s) > MOST_CLOCK_OFFSET_S and not simulated_time:
        text = f'stamps are {worst_s:+.1f} s from the host: a recording, or a changed host clock'
        findings.append(Finding('camera clock', Level.WARN, text))
    elif apart_s <= MOST_CLOCK_OFFSET_S:
        findings.append(ok('camera clock', f'{1e3 * worst_s:+.0f} ms from the host'))
    return findings


def progress_table(
    meters: Sequence[TopicMeter], title: str, *, dropped: int, disk_bytes: int
) -> Table:
    """Return the state of a recording.

    Args:
        meters: Its topics; those without messages are left out.
        title: Folder and elapsed time.
        dropped: Messages that were not written because the disk was too slow.
        disk_bytes: Space left.
    """
    size = sum(meter.size for meter in meters)
    caption = (
        f'{size / 1e6:.1f} MB, {disk_bytes / 1e9:.1f} GB left on the disk, '
        f'{dropped} messages dropped'
    )
    table = Table(title=title, title_justify='left', caption=caption, caption_justify='left')
    table.add_column('topic')
    for heading in ('messages', 'Hz', 'MB', 'lost'):
        table.add_column(heading, justify='right')
    for meter in meters:
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

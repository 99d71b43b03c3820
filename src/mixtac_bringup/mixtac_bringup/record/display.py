# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table that is shown before, while and after a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from mixtac_bringup.record.checks import ERROR, WARN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_bringup.record.checks import Finding
    from mixtac_bringup.record.meter import TopicMeter

_COLOUR = {WARN: 'yellow', ERROR: 'red'}


def findings_table(findings: Sequence[Finding]) -> Table:
    """Return what the checks found."""
    table = Table(title='Before recording', title_justify='left')
    for heading in ('', 'check', 'found'):
        table.add_column(heading)
    for each in findings:
        table.add_row(each.level, each.name, each.text, style=_COLOUR.get(each.level))
    return table


def progress_table(
    meters: Sequence[TopicMeter], title: str, *, dropped: int, disk_bytes: int
) -> Table:
    """Return the state of a recording.

    Args:
        meters: Its topics; those without messages are left out.
        title: Where to, since when.
        dropped: Messages that were not written.
        disk_bytes: Space left.
    """
    size = sum(meter.octets for meter in meters)
    caption = (
        f'{size / 1e6:.1f} MB, {disk_bytes / 1e9:.1f} GB left on the disk, '
        f'{dropped} messages not written'
    )
    table = Table(title=title, title_justify='left', caption=caption, caption_justify='left')
    table.add_column('topic')
    for heading in ('messages', 'Hz', 'MB', 'missing'):
        table.add_column(heading, justify='right')
    for meter in meters:
        if meter.messages:
            table.add_row(
                meter.topic.name,
                str(meter.messages),
                f'{meter.rate_hz:.1f}',
                f'{meter.octets / 1e6:.2f}',
                str(meter.missing),
                style='yellow' if meter.missing else None,
            )
    return table

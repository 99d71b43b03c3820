# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Forces and rates of a running sensor, shown in the terminal."""

from __future__ import annotations

import math
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.live import Live
from rich.table import Table

if TYPE_CHECKING:
    from mixtac.monitor_node import Monitor

_BLOCKS = ' ▁▂▃▄▅▆▇█'
_HISTORY = 60
PERIOD_S: Final = 0.2
"""Time between two updates of the table [s]."""
LINE_PERIOD_S: Final = 5.0
"""Time between two lines where the output is not a terminal [s]."""


def show(
    console: Console, doing: Callable[[], str], values: Callable[[], Mapping[str, float | str]]
) -> None:
    """Show values until `doing` returns an empty text: a table in a terminal, else lines.

    Args:
        console: Where to show them.
        doing: Returns the present state of the sensor. Called several times a second; its errors
            end the table.
        values: Returns what to show, by name: forces [N], drawn over time, and texts.
    """
    terminal, due_s = console.is_terminal, time.monotonic()
    histories: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_HISTORY))
    table = Live(console=console, refresh_per_second=5)
    with table if terminal else nullcontext():
        while text := doing():
            if time.monotonic() >= due_s:
                due_s += PERIOD_S if terminal else LINE_PERIOD_S
                shown: dict[str, str] = {}
                for name, value in values().items():
                    if isinstance(value, float):
                        # Nothing is drawn where there is no force.
                        histories[name].append(0.0 if math.isnan(value) else value)
                        value = f'{value:7.3f} N'  # noqa: PLW2901
                    shown[name] = value
                if terminal:
                    table.update(_table(text, shown, histories))
                else:
                    line = '  '.join(f'{name} {value}' for name, value in shown.items())
                    console.print(f'{text}: {line}', soft_wrap=True)
            time.sleep(PERIOD_S)


def sensor_values(monitor: Monitor, *, reference: bool) -> Callable[[], dict[str, float | str]]:
    """Return a function for `show` that reads a running graph.

    Args:
        monitor: Listens to the graph.
        reference: Show the reference force too.
    """
    last_s, last_count = time.monotonic(), monitor.estimate.received

    def values() -> dict[str, float | str]:
        nonlocal last_s, last_count
        now_s, count = time.monotonic(), monitor.estimate.received
        rate_hz = (count - last_count) / max(now_s - last_s, 1e-6)
        last_s, last_count = now_s, count
        forces = {'estimate': monitor.estimate.latest_n}
        if reference:
            forces['reference'] = monitor.measured.latest_n
        return {**forces, 'rate': f'{rate_hz:5.0f} Hz', 'camera': '  '.join(_rates(monitor))}

    return values


def _rates(monitor: Monitor) -> Iterator[str]:
    found = monitor.values('driver')
    for key in ('events', 'packets', 'frames'):
        if f'{key} per second' in found:
            yield f'{float(found[f"{key} per second"]):.0f} {key}/s'


def _table(text: str, shown: Mapping[str, str], histories: Mapping[str, deque[float]]) -> Table:
    table = Table(title=f'Mixtac: {text}', title_justify='left', show_header=False)
    peak = max((v for each in histories.values() for v in each if v > 1.0), default=1.0)
    top = len(_BLOCKS) - 1
    for name, value in shown.items():
        history = histories.get(name, ())
        blocks = (max(0, min(top, round(v / peak * top))) for v in history)
        table.add_row(name, value, ''.join(_BLOCKS[each] for each in blocks))
    return table

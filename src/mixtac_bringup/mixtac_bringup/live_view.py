# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a run shows in the terminal while it goes on."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from rich.live import Live
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from mixtac_bringup.monitor_node import Monitor

_BLOCKS = ' ▁▂▃▄▅▆▇█'
_PERIOD_S = 0.2
_PLAIN_PERIOD_S = 2.0


class LiveView:
    """Shows rates and forces; a table in a terminal, a line now and then elsewhere.

    Args:
        console: Where to show it.
        monitor: What to show.
        namespace: Namespace of the sensor.
        width: Length of the force history in characters.
    """

    def __init__(self, console: Console, monitor: Monitor, namespace: str, width: int = 60) -> None:
        self._console = console
        self._monitor = monitor
        self._namespace = namespace.strip('/')
        self._estimates: deque[float] = deque(maxlen=width)
        self._references: deque[float] = deque(maxlen=width)
        self._last = (time.monotonic(), 0, 0)
        self._rates = (0.0, 0.0)

    def show(self, seconds: float, check: Callable[[], None]) -> None:
        """Show for a while; `check` is called all along and may raise to end it."""
        end = time.monotonic() + seconds
        if not self._console.is_terminal:
            self._show_plain(end, check)
            return
        with Live(self._table(0.0), console=self._console, refresh_per_second=5) as live:
            while (left := end - time.monotonic()) > 0:
                time.sleep(min(_PERIOD_S, left))
                check()
                self._sample()
                live.update(self._table(left))

    def _show_plain(self, end: float, check: Callable[[], None]) -> None:
        next_line = time.monotonic() + _PLAIN_PERIOD_S
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(_PERIOD_S, left))
            check()
            if time.monotonic() >= next_line:
                next_line += _PLAIN_PERIOD_S
                self._sample()
                self._console.print(
                    f'{left:5.1f} s left  force {self._estimates[-1]:7.3f} N  reference '
                    f'{self._references[-1]:7.3f} N  {self._rates[0]:5.0f} Hz  {self._events()}'
                )

    def _sample(self) -> None:
        now, forces, references = (
            time.monotonic(),
            self._monitor.force_count,
            self._monitor.reference_count,
        )
        then, old_forces, old_references = self._last
        span = max(now - then, 1e-6)
        self._rates = ((forces - old_forces) / span, (references - old_references) / span)
        self._last = (now, forces, references)
        _, _, force = self._monitor.force()
        self._estimates.append(float(force[-1]) if len(force) else float('nan'))
        self._references.append(self._monitor.reference_n)

    def _events(self) -> str:
        values = self._monitor.diagnostics.get(f'{self._namespace}/driver', {})
        shown = (
            ('events', 'kev/s', 1e-3),
            ('packets', 'packets/s', 1.0),
            ('frames', 'frames/s', 1.0),
        )
        return '  '.join(
            f'{float(values[f"{key} per second"]) * scale:.0f} {unit}'
            for key, unit, scale in shown
            if f'{key} per second' in values
        )

    def _table(self, left: float) -> Table:
        table = Table(title=f'Mixtac, {left:.0f} s left', title_justify='left', show_header=False)
        peak = max([1.0, *(v for v in (*self._estimates, *self._references) if v == v)])  # noqa: PLR0124
        for name, history, rate in (
            ('estimate', self._estimates, self._rates[0]),
            ('reference', self._references, self._rates[1]),
        ):
            latest = history[-1] if history else float('nan')
            table.add_row(
                name, f'{latest:7.3f} N', Text(_sparkline(history, peak)), f'{rate:5.0f} Hz'
            )
        table.add_row('camera', '', self._events(), '')
        return table


def _sparkline(values: deque[float], peak: float) -> str:
    top = len(_BLOCKS) - 1
    return ''.join(
        _BLOCKS[min(top, max(0, round(value / peak * top)))] if value == value else ' '  # noqa: PLR0124
        for value in values
    )

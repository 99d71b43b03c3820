# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Forces and rates of a running sensor, shown in the terminal."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_cli.monitor_node import Monitor

_BLOCKS = ' ▁▂▃▄▅▆▇█'
_HISTORY = 60
PERIOD_S: Final = 0.2
"""Time between two looks at the values of the monitor [s]."""
_PLAIN_PERIOD_S = 2.0


class LiveTable:
    """Shows rates and forces: a table in a terminal, a line every two seconds elsewhere.

    Args:
        console: Where to show it.
        monitor: Source of the figures.
    """

    def __init__(self, console: Console, monitor: Monitor) -> None:
        self._console = console
        self._monitor = monitor
        self._estimates: deque[float] = deque(maxlen=_HISTORY)
        self._references: deque[float] = deque(maxlen=_HISTORY)
        self._last = (time.monotonic(), 0, 0)
        self._rates = (0.0, 0.0)

    def show(self, seconds: float, check: Callable[[], None]) -> None:
        """Show for some seconds and until the scenario has ended.

        Args:
            seconds: At least so long [s].
            check: Called repeatedly; may raise to end it.
        """
        end = time.monotonic() + seconds
        terminal = self._console.is_terminal
        period_s = PERIOD_S if terminal else _PLAIN_PERIOD_S
        due = time.monotonic() + period_s
        table = Live(self._table(0.0), console=self._console, refresh_per_second=5)
        with table if terminal else nullcontext():
            while (left := end - time.monotonic()) > 0 or self._playing():
                time.sleep(min(PERIOD_S, max(left, PERIOD_S / 2)))
                check()
                if time.monotonic() < due:
                    continue
                due += period_s
                self._sample()
                if terminal:
                    table.update(self._table(left))
                else:
                    self._console.print(self._line(left), soft_wrap=True)

    def _line(self, left: float) -> str:
        shown = f'{left:5.1f} s left' if left > 0.0 else 'still playing'
        return (
            f'{shown}  force {self._estimates[-1]:7.3f} N  reference {self._references[-1]:7.3f} N'
            f'  {self._rates[0]:5.0f} Hz  {self._events()}'
        )

    def _playing(self) -> bool:
        # On a slow host simulated time stops now and then, and the scenario takes longer.
        return self._monitor.values('virtual_sensor').get('playing') == 'True'

    def _sample(self) -> None:
        now, monitor = time.monotonic(), self._monitor
        forces, references = monitor.force_count, monitor.reference_count
        then, old_forces, old_references = self._last
        span = max(now - then, 1e-6)
        self._rates = ((forces - old_forces) / span, (references - old_references) / span)
        self._last = (now, forces, references)
        _, _, force = monitor.force()
        self._estimates.append(float(force[-1]) if len(force) else float('nan'))
        self._references.append(monitor.reference_n)

    def _events(self) -> str:
        values = self._monitor.values('driver')
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

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

from mixtac.monitor_node import Monitor

_BLOCKS = ' ▁▂▃▄▅▆▇█'
_STREAMS = ('events', 'packets', 'frames')
_HISTORY = 60
_NAN = float('nan')
PERIOD_S: Final = 0.2
"""Time between two updates of the table [s]."""
LINE_PERIOD_S: Final = 5.0
"""Time between two lines where the output is not a terminal [s]."""


class LiveTable:
    """Shows force and rates: a table in a terminal, a line every five seconds elsewhere.

    Args:
        console: Where to show it.
        monitor: Source of the values.
        reference: Show the reference force too.
    """

    def __init__(self, console: Console, monitor: Monitor, *, reference: bool = True) -> None:
        self._console = console
        self._monitor = monitor
        names = ('estimate', 'reference') if reference else ('estimate',)
        self._histories = {name: deque([_NAN], maxlen=_HISTORY) for name in names}
        self._last_s, self._last_count = time.monotonic(), monitor.estimate.received
        self._rate = 0.0

    def show(self, doing: Callable[[], str]) -> None:
        """Show the sensor until `doing` returns an empty text.

        Args:
            doing: Returns what the sensor does at the moment. Called several times a second; its
                errors end the table.
        """
        terminal = self._console.is_terminal
        period_s = PERIOD_S if terminal else LINE_PERIOD_S
        due_s = time.monotonic() + PERIOD_S
        table = Live(console=self._console, refresh_per_second=5)
        with table if terminal else nullcontext():
            while text := doing():
                if time.monotonic() >= due_s:
                    due_s += period_s
                    self._sample()
                    if terminal:
                        table.update(self._table(text))
                    else:
                        self._console.print(self._line(text), soft_wrap=True)
                time.sleep(PERIOD_S)

    def _sample(self) -> None:
        now_s, estimate = time.monotonic(), self._monitor.estimate
        self._rate = (estimate.received - self._last_count) / max(now_s - self._last_s, 1e-6)
        self._last_s, self._last_count = now_s, estimate.received
        values = {'estimate': estimate.latest_n, 'reference': self._monitor.measured.latest_n}
        for name, history in self._histories.items():
            history.append(values[name])

    def _line(self, text: str) -> str:
        forces = '  '.join(f'{name} {each[-1]:7.3f} N' for name, each in self._histories.items())
        return f'{text}: {forces}  {self._rate:5.0f} Hz  {self._camera()}'

    def _camera(self) -> str:
        values = self._monitor.values('driver')
        units = {
            'events': ('kev/s', 1e-3),
            'packets': ('packets/s', 1.0),
            'frames': ('frames/s', 1.0),
        }
        return '  '.join(
            f'{float(values[f"{key} per second"]) * scale:.0f} {unit}'
            for key, (unit, scale) in units.items()
            if f'{key} per second' in values
        )

    def _table(self, text: str) -> Table:
        table = Table(title=f'Mixtac: {text}', title_justify='left', show_header=False)
        known = [v for history in self._histories.values() for v in history if v > 1.0]
        for name, history in self._histories.items():
            line = Text(_sparkline(history, max(known, default=1.0)))
            table.add_row(name, f'{history[-1]:7.3f} N', line)
        table.add_row('force', f'{self._rate:5.0f} Hz', '')
        table.add_row('camera', '', self._camera())
        return table


def _sparkline(values: deque[float], peak: float) -> str:
    top = len(_BLOCKS) - 1
    return ''.join(
        _BLOCKS[min(top, max(0, round(value / peak * top)))] if value == value else ' '  # noqa: PLR0124
        for value in values
    )

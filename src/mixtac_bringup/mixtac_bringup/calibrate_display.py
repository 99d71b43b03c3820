# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac calibrate` shows in the terminal while it collects, and at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_driver.calibration.view_selection import Verdict, coverage_counts

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import Console

    from mixtac_bringup.calibrate_session import CalibrationSession
    from mixtac_driver.calibration.solve import Solution

_BAR = 24
_SHADES = ' ░▒▓█'


class CollectionDisplay:
    """A live panel in a terminal; elsewhere a line for each view that is kept.

    Args:
        console: Where to show it.
        session: What to show.
    """

    def __init__(self, console: Console, session: CalibrationSession) -> None:
        self._console = console
        self._session = session
        self._live: Live | None = None

    def __enter__(self) -> CollectionDisplay:
        """Start the live panel."""
        if self._console.is_terminal:
            self._live = Live(self._panel(), console=self._console, refresh_per_second=5)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last panel on the screen."""
        if self._live is not None:
            self._live.update(self._panel())
            self._live.stop()

    def update(self) -> None:
        """Show the session as it is now."""
        if self._live is not None:
            self._live.update(self._panel())
        elif self._session.last.verdict is Verdict.KEPT:
            self._console.print(self._line())

    def _line(self) -> str:
        session = self._session
        shares = ' '.join(f'{name} {100 * share:.0f}%' for name, share in session.progress())
        label = session.last.view.label if session.last.view else ''
        return f'view {len(session.images):2d} ({label})  {shares}  {_fit(session.rms_px)}'

    def _panel(self) -> Group:
        session, verdicts = self._session, self._session.selection.verdicts
        table = Table(title='Camera calibration', title_justify='left', show_header=False)
        table.add_row('images', f'{session.seen}, board found in {session.found}')
        table.add_row('views kept', '  '.join(f'{each.value} {verdicts[each]}' for each in Verdict))
        table.add_row('last image', str(session.last))
        for name, share in session.progress():
            filled = round(share * _BAR)
            table.add_row(name, f'{"█" * filled}{"·" * (_BAR - filled)} {100 * share:3.0f} %')
        table.add_row('corners', _coverage_map(session))
        table.add_row('fit', _fit(session.rms_px))
        table.add_row('next', session.hint())
        return Group(table, Text('Ctrl-C ends collecting and calibrates with what is there'))


def print_solution(console: Console, solution: Solution) -> None:
    """Print the parameters with their standard deviations, and the errors."""
    calibration = solution.calibration
    table = Table(
        title=f'{calibration.name}, {calibration.width}x{calibration.height}, {calibration.model}',
        title_justify='left',
    )
    for heading in ('parameter', 'value', 'std. deviation'):
        table.add_column(heading, justify='left' if heading == 'parameter' else 'right')
    for name, (value, deviation) in solution.parameters().items():
        pixels = name in ('fx', 'fy', 'cx', 'cy')
        unit, digits = (' px', 2) if pixels else ('', 5)
        table.add_row(name, f'{value:.{digits}f}{unit}', f'{deviation:.{digits + 1}f}{unit}')
    console.print(table)
    console.print(
        f'reprojection error {solution.rms_px:.3f} px, largest {solution.max_px:.2f} px, '
        f'{len(solution.views)} views, corners in {100 * solution.coverage:.0f} % of the image'
    )
    for view, error in solution.removed:
        console.print(f'view {view.label} left out: its error was {error:.2f} px')
    if solution.folded:
        console.print(
            f'{100 * solution.folded:.1f} % of the image have no rectified place: no corner was '
            'seen there and the model folds back'
        )


def _fit(rms_px: float) -> str:
    return f'reprojection error {rms_px:.3f} px' if rms_px == rms_px else 'not yet'  # noqa: PLR0124


def _coverage_map(session: CalibrationSession) -> str:
    counts = coverage_counts(session.selection.views)
    top = max(1, int(counts.max()))
    levels = len(_SHADES) - 1
    return '\n'.join(
        ''.join(_SHADES[-(-int(count) * levels // top)] * 2 for count in row) for row in counts
    )

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures on the terminal: all of them, however narrow it is."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from mixtac_learning.judge.report import COLUMNS, show_figures

FIGURES = {
    profile: {name: row + column / 1000 for column, name in enumerate(COLUMNS)}
    for row, profile in enumerate(('long_term', 'unseen_gel_one_gain'))
}


def printed(width: int) -> str:
    text = io.StringIO()
    show_figures(Console(file=text, width=width), 'trials', FIGURES)
    return text.getvalue()


@pytest.mark.parametrize('width', [40, 80, 100, 133, 250])
def test_every_figure_is_readable(width):
    text = printed(width)
    assert max(map(len, text.splitlines())) <= width
    assert '\u2026' not in text
    for row in FIGURES.values():
        for value in row.values():
            assert f' {value:.3f} ' in text


def test_wide_terminals_get_one_table():
    assert printed(320).count('trials') == 1
    assert printed(80).count('trials') > 1

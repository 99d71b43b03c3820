# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What ends a process is one line, whatever a name holds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.errors import ERROR, MixtacError, error_line


@given(st.text())
def test_a_line_stays_one_line_and_tells_a_terminal_nothing(name):
    line = error_line(str(MixtacError(name, remedy='rename it')))
    assert line.isprintable()
    assert line.splitlines() == [line]


@given(st.text(st.characters(exclude_categories=['C', 'Z']) | st.just(' ')))
def test_what_can_be_printed_is_left_as_it_is(text):
    assert error_line(text) == ERROR + text

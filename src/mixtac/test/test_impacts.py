# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is said and drawn of objects that were struck."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mixtac.impacts import ImpactLog, draw_impacts
from mixtac_core.node.files import FileError

if TYPE_CHECKING:
    from pathlib import Path


def logged(falls_mm: float, *, seen: bool = True, stopped: str = '') -> ImpactLog:
    """Return the log of an impact after which the object moved, and was put back."""
    log = ImpactLog()
    for k in range(100):
        log.on_place(1e-3 * k, 0.5)
    log.struck(0.1)
    for k in range(100, 300):
        log.on_place(1e-3 * k, 0.5 + falls_mm * min((k - 100) / 50.0, 1.0))
        log.on_slip(1e-3 * k, 0.3, stopped, slipping=seen and k > 120)
    if falls_mm > 5.0:
        log.on_place(0.3, 0.0)  # the simulation puts back what has fallen
    return log


def test_an_object_that_was_held_moved_by_its_displacement() -> None:
    log = logged(1.2)
    (impact,) = log.impacts
    assert impact.moved_mm == pytest.approx(1.2)
    assert impact.held
    assert impact.detected_s == pytest.approx(0.121)
    assert impact.places[0][0] == pytest.approx(0.05)
    assert '1.20 mm' in log.close()


def test_an_object_that_fell_has_fallen_although_it_was_put_back() -> None:
    log = logged(50.0, seen=False)
    assert not log.impacts[0].held
    words = log.close()
    assert 'FELL' in words
    assert 'not detected' in words
    assert '0 of 1' in log.summary()


def test_a_stop_is_told_with_its_reason() -> None:
    assert 'too much force' in logged(1.0, stopped='too much force').close()


def test_a_run_without_impacts_says_so() -> None:
    assert 'no impact' in ImpactLog().summary()


def test_impacts_are_drawn(tmp_path: Path) -> None:
    impacts = [*logged(1.0).impacts, *logged(50.0).impacts]
    draw_impacts(impacts, tmp_path / 'slip.png')
    assert (tmp_path / 'slip.png').stat().st_size > 1000
    with pytest.raises(FileError):
        draw_impacts(impacts, tmp_path / 'slip.txt')

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""False alarms are summed over the pieces of a scene, and stored."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from rich.console import Console

from mixtac_lab.slip import detectors
from mixtac_lab.slip.detectors import flicker_of
from mixtac_lab.store import Store

if TYPE_CHECKING:
    from pathlib import Path


def test_pieces_are_summed_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detectors, 'PIECE_S', 0.05)
    monkeypatch.setattr(detectors, 'LEARN_S', 0.02)
    store, console = Store(tmp_path), Console(quiet=True)
    arguments = ('flicker', 0.1, 'easy', store, console)
    found = detectors.count_alarms(*arguments)
    assert found['seconds'] == pytest.approx(0.1)
    assert found['flow'] == 0
    assert found['mean_count'] > 0.0
    assert len(list(tmp_path.glob('quiet_flicker_*.json'))) == 2
    again = detectors.count_alarms(*arguments)
    assert again == found


def test_lamps_ripple_at_twice_the_mains_by_several_depths() -> None:
    lamps = [flicker_of(seed) for seed in range(6)]
    assert {lamp.hz for lamp in lamps} == {100.0}
    assert len({lamp.depth for lamp in lamps}) == 3
    assert not any(lamp.small for lamp in lamps)


def test_a_lamp_that_is_switched_on_makes_a_burst_of_events(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(detectors, 'LEARN_S', 0.02)
    blocks = detectors.quiet_blocks('switched', 0.04, 2, 'easy')
    counts = [(block.end_us, len(block.events)) for block in blocks]
    before = max(count for end_us, count in counts if end_us <= 20_000)
    after = max(count for end_us, count in counts if end_us > 20_000)
    assert after > 5 * before

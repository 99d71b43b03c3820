# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A stopped measurement goes on where it was, and false alarms are summed over its pieces."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_lab.slip import detectors
from mixtac_lab.slip.detectors import flicker_of
from mixtac_lab.slip.trials import draw_objects
from mixtac_lab.store import Kept, digest
from mixtac_slip_control.parameters import SlipControlParameters

if TYPE_CHECKING:
    from pathlib import Path


def refuse() -> object:
    raise AssertionError('measured a second time')


def test_what_was_measured_is_not_measured_again(tmp_path: Path) -> None:
    path = tmp_path / 'kept.jsonl'
    kept = Kept(path)
    assert kept.get('a', lambda: {'slip': 0.5, 'arrest': math.nan})['slip'] == 0.5
    assert kept.get('a', refuse)['slip'] == 0.5
    kept.get('b', lambda: [1, 2])
    later = Kept(path)
    assert math.isnan(later.get('a', refuse)['arrest'])
    assert later.get('b', refuse) == [1, 2]
    with pytest.raises(AssertionError, match='second'):
        later.get('c', refuse)
    assert len(path.read_text().splitlines()) == 2


def test_other_settings_have_another_name() -> None:
    settings = SlipControlParameters()
    other = dataclasses.replace(settings, arm_lag=5e-3)
    assert digest(settings, 'easy') == digest(SlipControlParameters(), 'easy')
    assert len({digest(settings, 'easy'), digest(settings, 'full'), digest(other, 'easy')}) == 3


def test_pieces_are_summed_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detectors, 'PIECE_S', 0.05)
    monkeypatch.setattr(detectors, 'LEARN_S', 0.02)
    kept = Kept(tmp_path / 'kept.jsonl')
    found = detectors.count_alarms('flicker', 0.1, SlipControlParameters(), 'easy', kept)
    assert found.seconds == pytest.approx(0.1)
    assert found.flow == 0
    assert found.mean_count > 0.0
    assert len((tmp_path / 'kept.jsonl').read_text().splitlines()) == 2
    again = detectors.count_alarms('flicker', 0.1, SlipControlParameters(), 'easy', kept)
    assert again == found


def test_lamps_ripple_at_twice_the_mains_by_several_depths() -> None:
    lamps = [flicker_of(seed) for seed in range(6)]
    assert {lamp.hz for lamp in lamps} == {100.0}
    assert len({lamp.depth for lamp in lamps}) == 3
    assert not any(lamp.small for lamp in lamps)


def test_the_ways_of_all_objects_are_drawn(tmp_path: Path) -> None:
    way = np.linspace(0.0, 1.0, 91)
    path = tmp_path / 'objects.png'
    draw_objects(path, {'box': [way, 0.5 * way], 'cup': [way]}, {'box': 0.7, 'cup': 0.9})
    assert path.read_bytes().startswith(b'\x89PNG')

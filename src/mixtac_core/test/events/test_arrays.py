# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event arrays."""

from __future__ import annotations

import numpy as np

from mixtac_core.events.arrays import Events


def ramp(n: int) -> Events:
    i = np.arange(n)
    return Events(i.astype(np.int64) * 10, i.astype(np.uint16), i.astype(np.uint16), i % 2 == 0)


def test_slices_masks_and_indices_choose_events() -> None:
    e = ramp(6)
    assert e[2:4].t.tolist() == [20, 30]
    assert np.shares_memory(e[2:4].t, e.t)
    assert e[e.polarity].x.tolist() == [0, 2, 4]
    assert e[np.array([5, 0])].y.tolist() == [5, 0]


def test_between_is_half_open() -> None:
    assert ramp(6).between(10, 30).t.tolist() == [10, 20]
    assert len(ramp(6).between(11, 20)) == 0


def test_concatenate_and_shift() -> None:
    assert len(Events.empty()) == 0
    assert len(Events.concatenate([])) == 0
    both = Events.concatenate([ramp(2), ramp(3).shifted(1_700_000_000_000_000)])
    assert both.t.tolist() == [0, 10, *(1_700_000_000_000_000 + 10 * i for i in range(3))]
    assert both.t.dtype == np.int64

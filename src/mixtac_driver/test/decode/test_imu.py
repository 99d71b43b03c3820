# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial samples: every set of groups and scales, and what is missing from them."""

from __future__ import annotations

import numpy as np
from davis_oracle import Oracle
from decoder_cases import assert_same, decode

from mixtac_driver.davis346.model import Geometry


def both(words):
    found = decode(words)
    assert_same(found, Oracle(Geometry()).words(words))
    return found


def sample(info, payload):
    return [5, 0x5300 | info, *(0x5000 | int(b) for b in payload), 7]


def size(info):
    return 6 * bool(info & 0x80) + 2 * bool(info & 0x20) + 6 * bool(info & 0x40)


def test_every_set_of_groups_and_scales_with_any_number_of_bytes():
    rng = np.random.default_rng(1)
    for info in range(256):
        for extra in (-1, 0, 1):
            payload = rng.integers(0, 256, max(size(info) + extra, 0))
            found = both([0x8009, *sample(info, payload)])
            # A byte too many is refused, and the sample before it is whole.
            assert len(found.samples) == (size(info) > 0 and extra >= 0)


def test_lost_byte_drops_the_sample_and_not_the_next():
    words = sample(0xE0, range(14))
    for k in range(len(words)):
        found = both([*words[:k], *words[k + 1 :], *words])
        assert len(found.samples) == 1
        counters = found.decoder.counters
        assert counters.imu_dropped + counters.words_unexpected > 0

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counters of the camera itself."""

from __future__ import annotations

from dataclasses import replace

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.control import read_64, read_statistics

COUNTED = {
    (1, 81): 1, (1, 82): 2, (1, 84): 3, (1, 86): 4, (1, 88): 5, (1, 90): 6, (1, 92): 7,
    (0, 82): 8, (0, 84): 9,
}  # fmt: skip


@pytest.fixture
def fake():
    return FakeCamera(registers=COUNTED)


@pytest.fixture
def camera(fake):
    with Davis346(backend=FakeBackend(fake)) as camera:
        yield camera


def test_counters_are_64_bits_upper_half_first(camera):
    statistics = camera.control.statistics()
    assert statistics.rows == (1 << 32) + 2
    assert statistics.columns == 3
    assert statistics.dropped == 4
    assert statistics.filtered_pixels == 5
    assert statistics.filtered_background_activity == 6
    assert statistics.filtered_refractory == 7
    assert statistics.external_input_dropped == 8
    assert statistics.dvs_dropped == 9
    assert statistics.lost == 4 + 8 + 9


class Ticking:
    """A 64-bit counter that goes on with every read of one of its halves."""

    def __init__(self, value, step):
        self.value, self.step = value, step

    def read(self, _module, parameter):
        value = self.value
        self.value += self.step
        return value >> 32 if parameter == 83 else value & 0xFFFFFFFF


@pytest.mark.parametrize('start', [(1 << 32) - 3, (1 << 32) - 2, (1 << 32) - 1, 1 << 32, 5])
def test_an_overflow_between_the_halves_is_noticed(start):
    counter = Ticking(start, 1)
    assert start <= read_64(counter, 1, 83) <= counter.value


def test_counters_that_the_logic_lacks_are_not_read(camera, fake):
    features = replace(camera.identity.features, dvs_statistics=False, mux_statistics=False)
    fake.log.clear()
    statistics = read_statistics(None, features)
    assert statistics.lost == 0
    assert fake.log == []

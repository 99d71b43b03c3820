# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bias encodings against the values that libcaer sends, and the order of the register writes."""

from __future__ import annotations

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_core.node.parameters import ParameterError
from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.biases import DEFAULT_BIASES
from mixtac_driver.davis346.writes import register_writes
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.parameters import DriverParameters

LIBCAER = DriverParameters(
    aps_exposure=4000, background_activity_filter_enabled=True, usb_early_packet_delay=1000
)
"""Defaults of libcaer 3.3 where ours differ."""
SENT = {
    0: 411, 1: 405, 2: 480, 3: 449, 4: 469, 8: 23119, 9: 32126, 10: 17023, 11: 24575, 12: 16415,
    13: 26895, 14: 9133, 15: 4365, 16: 16797, 17: 24909, 18: 28095, 19: 20813, 20: 31, 21: 25549,
    22: 21279, 23: 26047, 24: 17677, 25: 31117, 26: 24575, 27: 24575, 34: 24559, 35: 33808,
    36: 33808,
}  # fmt: skip


@pytest.fixture(scope='module')
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


def test_default_biases_are_those_libcaer_sends():
    biases = DEFAULT_BIASES.values()
    assert {bias.address: bias.encode(DriverParameters()) for bias in biases} == SENT
    # Without a parameter, a field has its default.
    assert {bias.address: bias.encode(None) for bias in biases} == SENT
    assert [bias.address for bias in biases] == sorted(SENT)


def test_default_writes_are_the_102_of_libcaer_in_its_order(identity):
    chip = [*((p, 0) for p in range(128, 136)), (136, 1), (137, 0), (138, 1)]
    chip += [(140, 0), (141, 0), (143, 1), (144, 0)]
    pixels = [(11 + k, (260, 346)[k % 2]) for k in range(16)]
    dvs = [(4, 0), (5, 0), *pixels, (31, 1), (32, 8), (33, 0), (34, 1), (41, 0), (42, 0)]
    dvs += [(43, 345), (44, 259), (51, 0), (52, 5), (61, 0), (62, 0), (63, 0)]
    aps = [(7, 1), (8, 0), (9, 0), (10, 345), (11, 259), (12, 120960), (13, 1209600)]
    imu = [(5, 0), (6, 1), (7, 1), (9, 1), (10, 1)]
    external = [(1, 0), (2, 0), (3, 1), (4, 1), (5, 1210), (11, 0), (12, 1), (13, 1210), (14, 605)]
    expected = [
        *((5, *w) for w in [*SENT.items(), *chip]),
        (0, 4, 1),
        (0, 5, 1),
        *((1, *w) for w in dvs),
        (2, 5, 1),
        (5, 142, 1),
        *((2, *w) for w in aps),
        *((3, *w) for w in imu),
        *((4, *w) for w in [*external, (15, 0), (16, 0)]),
        (9, 1, 80640),
    ]
    writes = register_writes(LIBCAER, identity)
    assert [tuple(map(int, w)) for w in writes] == expected
    assert len(writes) == 102


def test_registers_that_the_logic_lacks_are_not_written(identity):
    lacking = FakeCamera(registers={(1, 30): 0, (1, 50): 0, (4, 10): 0})
    with Davis346(backend=FakeBackend(lacking)) as camera:
        writes = register_writes(LIBCAER, camera.identity)
    gone = {w[:2] for w in register_writes(LIBCAER, identity)} - {w[:2] for w in writes}
    assert gone == {*((1, n) for n in (31, 32, 33, 34, 51, 52)), *((4, n) for n in range(11, 17))}


@pytest.mark.parametrize(
    ('change', 'kind', 'value'),
    [
        ({'aps_exposure': 1 << 22}, ParameterError, '4194304'),
        ({'roi_start_col': 5, 'roi_end_col': 4}, ConfigurationError, '5 .. 4'),
        ({'ApsCas_voltage': 99}, ParameterError, '99'),
    ],
)
def test_settings_that_do_not_fit_are_refused(identity, change, kind, value):
    with pytest.raises(kind) as error:
        register_writes(DriverParameters(**change), identity)
    assert value in str(error.value)

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What was drawn for a trial can be kept as JSON and says what the trial used."""

import json

import pytest

from mixtac_sim.world.device import (
    describe_conditions,
    describe_device,
    describe_reference,
    draw_conditions,
    draw_device,
)
from mixtac_sim.world.effects import PRESETS, preset
from mixtac_sim.world.instruments import ReferenceSensor


@pytest.mark.parametrize('name', PRESETS)
def test_records_survive_json(name):
    device, day = draw_device(3, preset(name)), draw_conditions(4, preset(name))
    reference = ReferenceSensor(4, preset=preset(name))
    records = (describe_device(device), describe_conditions(day), describe_reference(reference))
    for record in records:
        assert json.loads(json.dumps(record)) == record
    assert records[0]['layer']['modulus_kpa'] == device.layer.modulus_kpa
    assert records[0]['beads'] == len(device.markers.x_mm)
    assert records[1]['contact_mm'] == list(day.contact_mm)
    assert records[2]['offset_s'] == reference.offset_s

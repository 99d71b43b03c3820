# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stated size: 0.517 M parameters and 2.0 GFLOPs, by torch's own counter."""

from __future__ import annotations

import pytest

from mixtac_fger.config import ConfigError
from mixtac_learning.network import count_parameters
from mixtac_learning.paper.config import MODELS, PaperConfig
from mixtac_learning.paper.networks import build, operations_per_cycle


def test_fger_net_has_the_size_that_the_paper_states():
    config = PaperConfig()
    assert count_parameters(build(config)) == pytest.approx(0.517e6, rel=0.005)
    assert operations_per_cycle(config) == pytest.approx(2.0e9, rel=0.01)


@pytest.mark.parametrize('model', MODELS)
def test_fewer_pixels_and_events_take_fewer_operations(model):
    small, large = (
        PaperConfig(model=model, scale=scale, events_per_packet=events)
        for scale, events in ((4, 64), (3, 128))
    )
    assert 0 < operations_per_cycle(small) < operations_per_cycle(large)


def test_impossible_configurations_are_refused():
    with pytest.raises(ConfigError):
        PaperConfig(model='snn')
    with pytest.raises(ConfigError):
        PaperConfig(event_widths=(64, 0))
    with pytest.raises(ConfigError):
        PaperConfig.from_dict({'depth': 3})
    config = PaperConfig(model='fusion', scale=2)
    assert PaperConfig.from_dict(config.to_dict()) == config

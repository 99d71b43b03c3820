# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stated size: 0.517 M parameters and 2.0 GFLOPs, by torch's own counter."""

from __future__ import annotations

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from mixtac_fger.config import ConfigError
from mixtac_learning.network import count_parameters
from mixtac_learning.paper.config import MODELS, PaperConfig
from mixtac_learning.paper.networks import build, one_cycle, operations_per_cycle


def counted(config: PaperConfig) -> int:
    network = build(config).train()
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        network(one_cycle(config), network.initial_state(1))
    return counter.get_total_flops()


def test_fger_net_has_the_size_that_the_paper_states():
    config = PaperConfig()
    assert count_parameters(build(config)) == pytest.approx(0.517e6, rel=0.005)
    assert counted(config) == pytest.approx(2.0e9, rel=0.01)


@pytest.mark.parametrize('model', MODELS)
def test_operations_counted_by_hand_are_those_of_the_counter(model):
    for fields in ({'scale': 4, 'events_per_packet': 64}, {'scale': 3, 'channels': 16}):
        config = PaperConfig(model=model, **fields)
        assert operations_per_cycle(config) == counted(config)


def test_impossible_configurations_are_refused():
    with pytest.raises(ConfigError):
        PaperConfig(model='snn')
    with pytest.raises(ConfigError):
        PaperConfig(event_widths=(64, 0))
    with pytest.raises(ConfigError):
        PaperConfig.from_dict({'depth': 3})
    config = PaperConfig(model='fusion', scale=2)
    assert PaperConfig.from_dict(config.to_dict()) == config

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A gain of the force, folded into the weights: an ordinary weight file, exact to rounding."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import torch

from mixtac_fger.errors import CalibrationError

if TYPE_CHECKING:
    from torch import nn

    from mixtac_fger.network import FgerNetwork


@torch.no_grad()
def with_gain(network: FgerNetwork, gain: float) -> FgerNetwork:
    """Return a network whose forces are `gain` times those of `network`, deviations as well.

    Everything that makes a force is multiplied, everything that reads one is divided, so that the
    recurrent state runs through the same values as before.

    Args:
        network: Not changed.
        gain: Above 0.

    Raises:
        CalibrationError: The gain is no such number.
    """
    if not 0.0 < gain < float('inf'):
        raise CalibrationError(f'a gain of {gain} is impossible: check the known forces')
    scaled = copy.deepcopy(network)
    for layer in (scaled.increment[2], scaled.correction[2], scaled.frame.head):
        _multiply(layer, gain)
    scaled.gates_force.weight /= gain
    first = scaled.correction.get_parameter('0.weight')
    first[:, 0] /= gain
    if scaled.deviation is not None:
        scaled.deviation.hidden.weight[:, -1] /= gain
        scaled.deviation.scale *= gain
    return scaled


def _multiply(layer: nn.Module, gain: float) -> None:
    for parameter in layer.parameters():
        parameter.mul_(gain)

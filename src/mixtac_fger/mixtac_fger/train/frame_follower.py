# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the recurrent path begins: it follows the frames, events change hardly anything yet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from mixtac_fger.network import FgerNetwork

FOLLOWED = 0.8
"""Part of the difference to a frame's force that is corrected at first."""
_SMALL = 0.1
"""Factor of the other weights that end in a force."""


@torch.no_grad()
def follow_frames(network: FgerNetwork) -> None:
    """Make MLP_corr correct `FOLLOWED` of the difference to the frames-only force, in place.

    Two of its hidden units become the halves of that difference above and below zero; MLP_corr
    would have to learn from scratch what the head of the frame network knows already.

    Args:
        network: Its frame network is trained.
    """
    hidden, output = (network.correction.get_submodule(name) for name in ('0', '2'))
    head = network.frame.head
    weight = torch.cat([-torch.ones_like(head.bias), head.weight[0]])
    for unit, sign in enumerate((1.0, -1.0)):
        hidden.get_parameter('weight')[unit] = sign * weight
        hidden.get_parameter('bias')[unit] = sign * head.bias[0]
    for last in (output, network.increment.get_submodule('2')):
        last.get_parameter('weight').mul_(_SMALL)
        last.get_parameter('bias').zero_()
    output.get_parameter('weight')[0, :2] = torch.tensor([FOLLOWED, -FOLLOWED])

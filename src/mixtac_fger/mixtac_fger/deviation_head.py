# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How uncertain a force is: a head beside the force, trained after it and calibrated."""

from __future__ import annotations

import torch
from torch import Tensor, nn

LOWEST, HIGHEST = -7.0, 2.0
"""Limits of the logarithm of a standard deviation before `DeviationHead.scale` [log N]."""


class DeviationHead(nn.Module):
    """Standard deviation of a force, from the recurrent state and the force itself.

    Args:
        state_size: Size of the recurrent state h.
        width: Width of the hidden layer.

    Attributes:
        scale: Factor that makes plus or minus one deviation cover 68.3 % of held-out windows.
    """

    def __init__(self, state_size: int, width: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(state_size + 1, width)
        self.output = nn.Linear(width, 1)
        self.scale: Tensor
        self.register_buffer('scale', torch.ones(1))

    def log_deviation(self, hidden: Tensor, force: Tensor) -> Tensor:
        """Return the logarithm of the uncalibrated deviation [log N], [...].

        Args:
            hidden: Recurrent state after a window, [..., state_size].
            force: Force at the end of the window [N], [...].
        """
        inputs = torch.cat([hidden, force[..., None]], dim=-1)
        raw = self.output(torch.relu(self.hidden(inputs)))[..., 0]
        return torch.Tensor(raw.clamp(LOWEST, HIGHEST))

    def forward(self, hidden: Tensor, force: Tensor) -> Tensor:
        """Return the calibrated standard deviation [N], arguments as in `log_deviation`."""
        return self.scale * self.log_deviation(hidden, force).exp()

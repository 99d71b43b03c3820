# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The network beside the gains of the sensors that it is trained on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from mixtac_fger.batches import mirror_frames
from mixtac_fger.network import FgerNetwork

if TYPE_CHECKING:
    from mixtac_fger.batches import Sequences
    from mixtac_fger.config import FgerConfig

_ENCODE_BATCH = 512


class GainedNetwork(nn.Module):
    """FGER-Net and one gain per sensor of the training data.

    How stiff a gel is cannot be seen: force is stiffness times what is seen. So each sensor of the
    training data has a gain, learned with the frame network and drawn towards 1, and the network
    learns the force on a gel of usual stiffness. A new sensor's gain is 1 until it is calibrated
    (`mixtac_fger.calibration`).

    Args:
        config: Network configuration.
        devices: Number of sensors.
    """

    def __init__(self, config: FgerConfig, devices: int) -> None:
        super().__init__()
        self.network = FgerNetwork(config)
        self.log_gains = nn.Parameter(torch.zeros(devices))

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.log_gains.device

    @property
    def gains(self) -> Tensor:
        """Gain of each sensor, by `Sequences.device`; without gradient."""
        return self.log_gains.detach().exp()

    def fit_scales(self, sequences: Sequences) -> None:
        """Set the input scales to the spread of the data; signed inputs keep their zero."""
        network = self.network
        events = sequences.event_features[sequences.valid].float()
        network.event.scale.copy_(events.flatten(0, -2).square().mean(0).sqrt().clamp(min=1e-3))
        frames = sequences.frame_inputs.float()
        scale = frames.square().mean((0, 2, 3)).sqrt()
        if 'frame' in network.config.frame_channels:
            channel = network.config.frame_channels.index('frame')
            network.frame.mean[channel] = frames[:, channel].mean()
            scale[channel] = frames[:, channel].std()
        network.frame.scale.copy_(scale.clamp(min=1e-3)[:, None, None])

    @torch.no_grad()
    def encode(self, sequences: Sequences, columns: bool = False, rows: bool = False) -> Tensor:
        """Return f_frame of all frames, [N, frame_size], optionally of their mirror images."""
        network = self.network
        parts = torch.split(sequences.frame_inputs, _ENCODE_BATCH)
        flipped = (mirror_frames(part.float(), network.config, columns, rows) for part in parts)
        return torch.cat([network.frame(part) for part in flipped])

    @torch.no_grad()
    def estimate(self, sequences: Sequences) -> tuple[Tensor, Tensor]:
        """Run all sequences from their start, with gains of 1.

        Returns:
            Force at the end of each window [T, B] and frames-only force of each frame [N], in N.
        """
        features = self.encode(sequences)
        state = self.network.initial_state(sequences.force.shape[1])
        events = sequences.event_features.float()
        force, _ = self.network(events, features, sequences.slots, state)
        return force, self.network.frame.force(features)

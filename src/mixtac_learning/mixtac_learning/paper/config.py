# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of the paper's networks; the default has the size that the paper states."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from mixtac_fger.config import ConfigError, from_mapping

MODELS = ('fger', 'frames', 'events', 'fusion')
"""FGER-Net; frames only; events only; feature level deep fusion."""
LIGHTS = ('intensity', 'reference')
"""What the frame network sees: intensities; or the logarithm of their ratio to those of the first
frames of the trial, without contact, less its mean over the frame, which removes lamp and
exposure."""
NORMS = ('group', 'batch')
"""Normalisation of the frame network: by each frame's own statistics, or by those of training."""


@dataclass(frozen=True)
class PaperConfig:
    """Shapes of FGER-Net as the paper describes it, and of its baselines.

    The paper states 0.517 M parameters and 2.0 GFLOPs and names the parts (part of a residual
    network with average pooling; a pointwise perceptron with max-pooling; LSTM; two perceptrons),
    not their widths. The defaults are the stem and first stage of a ResNet-18 with one input
    channel, and the widths that reach both numbers; others would as well.

    Attributes:
        model: One of `MODELS`.
        width: Columns of the sensor [px].
        height: Rows of the sensor [px].
        scale: Pixels averaged along each axis before the frame network: 1 is native resolution,
            for a GPU; 4 is what a CPU can train on, with 1/16 of the operations.
        window_us: Length Delta T of an event packet [us]; one force per packet.
        events_per_packet: Most events of a packet that the point network reads, spread evenly.
        channels: Channels of the residual network.
        blocks: Residual blocks of two convolutions each.
        event_widths: Widths of the point network.
        lstm_size: Size of the LSTM.
        increment_size: Hidden width of MLP_df.
        correction_size: Hidden width of MLP_corr, and of the regression heads of the baselines.
        sparse_channels: Channels of the convolutions on event frames (`fusion`).
        light: One of `LIGHTS`; across days only `reference` is of use, with `norm` `batch`.
        norm: One of `NORMS`.
    """

    model: str = 'fger'
    width: int = 346
    height: int = 260
    scale: int = 1
    window_us: int = 2000
    events_per_packet: int = 512
    channels: int = 64
    blocks: int = 2
    event_widths: tuple[int, ...] = (64, 128)
    lstm_size: int = 224
    increment_size: int = 135
    correction_size: int = 128
    sparse_channels: tuple[int, ...] = (16, 32, 64)
    light: str = 'intensity'
    norm: str = 'group'

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ConfigError: A value is impossible.
        """
        for name, known in (('model', MODELS), ('light', LIGHTS), ('norm', NORMS)):
            if getattr(self, name) not in known:
                raise ConfigError(
                    f'PaperConfig.{name} = {getattr(self, name)!r}: choose one of {known}'
                )
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            if any(isinstance(number, int) and number <= 0 for number in numbers):
                raise ConfigError(f'PaperConfig.{field.name} = {value}: give positive values')

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of the frame network's input."""
        return self.height // self.scale, self.width // self.scale

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PaperConfig:
        """Return the configuration of such values; absent ones keep their defaults.

        Raises:
            ConfigError: A field is unknown or impossible.
        """
        return from_mapping(cls, values, 'network')

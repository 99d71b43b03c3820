# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The configuration of FGER-Net: it fixes the meaning of the weights and the computing time."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, TypeVar

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, structure

T = TypeVar('T')


class ModelError(MixtacError):
    """A model file that is missing, damaged or made for another architecture."""


class ConfigError(MixtacError):
    """A network configuration with impossible values."""


def from_mapping(cls: type[T], values: object, where: str) -> T:
    """Return a configuration from plain values, checked; absent fields keep their defaults.

    Args:
        cls: A dataclass.
        values: As YAML and JSON give them.
        where: Section, for the message.

    Raises:
        ConfigError: A field is unknown, or a value has another type or is impossible.
    """
    try:
        return structure(values, cls, where)
    except FileError as error:
        raise ConfigError(error.message, remedy=error.remedy) from error


ARCHITECTURE = 'fger_small'
VERSION = 7
CELL_FEATURES = 4
"""Numbers per grid cell and window: flow x, flow y, ON count, OFF count."""
TURNING_WIDTHS = (4.5, 9.0, 13.5, 21.0)
"""Widths around the contact over which moments of a frame are summed [bins]."""
PRESSES = 3
"""Number of moments of a frame that the normal force follows from; see `mixtac_fger.moments`."""
MOMENTS = PRESSES + 7 + len(TURNING_WIDTHS)
"""Number of all moments of a frame."""
FEWEST_WINDOWS = 10
"""Least of `FgerConfig.history_windows`: what is read around a frame."""
LARGEST = 1_000_000
"""Largest number of a configuration: a weight file may come from anywhere."""


@dataclass(frozen=True)
class FgerConfig:
    """Shapes and signal processing of FGER-Net (the paper's Algorithm 1), small version.

    The displacement of the beads is measured in a frame that is averaged over `frame_bin` x
    `frame_bin` pixels and expressed as the logarithm of the ratio to its own mean: neither the
    exposure time, nor the lamp current, nor the number of bits of the image matter. The event
    encoder reads, per window, a coarse grid of sums.

    Attributes:
        width: Columns of the sensor [px].
        height: Rows of the sensor [px].
        window_us: Length of an event window [us], camera clock; one force per window.
        frame_bin: Pixels averaged along each axis for the displacement.
        gradient_bin: Pixels averaged along each axis for the log-gradient map that events are
            multiplied with; divides `frame_bin`.
        log_floor: Added to the intensity relative to the frame's mean before the logarithm.
        flow_radius: Half width of the least-squares box of the displacement [bins].
        flow_regularisation: Added to the diagonal of the mean structure tensor of the box
            [1/bin^2, log units]: how much texture a displacement needs.
        reference_frames: No-contact frames averaged into the reference.
        reference_stillness: Largest mean change of log contrast among these frames; a frame that
            changed more, and not by noise alone, restarts the reference, so that a moving contact
            does not become "nothing".
        grid_columns: Columns of the event grid.
        grid_rows: Rows of the event grid.
        cell_regularisation: As `flow_regularisation`, for the cells of the event grid [1/px^2].
        flow_limit: Largest magnitude of a cell's event displacement [px per threshold].
        event_hidden: Width of the event encoder's hidden layer.
        event_size: Size of the event feature f_e.
        lstm_size: Size of the recurrent state.
        mlp_size: Hidden width of MLP_df. It reads the event feature beside the recurrent state,
            which is bounded, so that an increment is not; and the moments of the latest frame,
            because how much force a motion makes depends on the width and the place of the contact.
        history_windows: How many windows the centre of an exposure may lie back.
        force_unit: Gain that was folded into the weights: forces in the training were so many
            times smaller.
        shear: Whether sideways force and torsion are estimated as well (`mixtac_fger.force_path`).
    """

    width: int = 346
    height: int = 260
    window_us: int = 2000
    frame_bin: int = 4
    gradient_bin: int = 2
    log_floor: float = 0.05
    flow_radius: int = 3
    flow_regularisation: float = 1e-3
    reference_frames: int = 5
    reference_stillness: float = 0.02
    grid_columns: int = 8
    grid_rows: int = 6
    cell_regularisation: float = 1e-4
    flow_limit: float = 50.0
    event_hidden: int = 32
    event_size: int = 24
    lstm_size: int = 40
    mlp_size: int = 24
    history_windows: int = 64
    force_unit: float = 1.0
    shear: bool = False

    def __post_init__(self) -> None:
        """Check the values against each other.

        Raises:
            ConfigError: A value is impossible.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if type(value) in {int, float} and not 0 < value <= LARGEST:
                raise ConfigError(
                    f'FgerConfig.{field.name} = {value}: give a number above 0, up to {LARGEST}'
                )
        fine, windows = self.gradient_bin, self.history_windows
        for wrong, name, wanted in (
            (self.frame_bin % fine, 'frame_bin', f'a multiple of gradient_bin = {fine}'),
            (windows < FEWEST_WINDOWS, 'history_windows', f'{FEWEST_WINDOWS} or more'),
        ):
            if wrong:
                raise ConfigError(f'FgerConfig.{name} = {getattr(self, name)!r}: give {wanted}')

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns of the event grid."""
        return self.grid_rows, self.grid_columns

    @property
    def gradient_shape(self) -> tuple[int, int]:
        """Rows and columns of the log-gradient map."""
        return self.height // self.gradient_bin, self.width // self.gradient_bin

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of the displacement."""
        rows, columns = self.gradient_shape
        ratio = self.frame_bin // self.gradient_bin
        return rows // ratio, columns // ratio

    @property
    def event_inputs(self) -> int:
        """Numbers that the event encoder reads per window."""
        return self.grid_columns * self.grid_rows * CELL_FEATURES

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> FgerConfig:
        """Return the configuration of all its fields.

        Raises:
            ConfigError: A field is unknown, missing or impossible.
        """
        odd = {field.name for field in dataclasses.fields(cls)}.symmetric_difference(values)
        if odd:
            raise ConfigError(
                f'FgerConfig fields {sorted(odd)} are missing or unknown',
                remedy='retrain the model',
            )
        return from_mapping(cls, values, 'FgerConfig')


STATISTICS = ('frame.spread', 'event.scale', 'deviation', 'shear.unit', 'shear.deviation')
"""Tensors of a weight file that are scales and deviations, not parameters."""


def tensor_shapes(config: FgerConfig) -> dict[str, tuple[int, ...]]:
    """Return the shape of each tensor that a weight file of this configuration holds, by name."""
    shapes: dict[str, tuple[int, ...]] = {}

    def linear(name: str, inputs: int, outputs: int, *, bias: bool = True) -> None:
        shapes[f'{name}.weight'] = (outputs, inputs)
        if bias:
            shapes[f'{name}.bias'] = (outputs,)

    shapes['frame.spread'], shapes['frame.press'] = (MOMENTS,), (PRESSES,)
    shapes['event.scale'] = (CELL_FEATURES,)
    linear('event.hidden', config.event_inputs, config.event_hidden)
    linear('event.output', config.event_hidden, config.event_size)
    gates = 4 * config.lstm_size
    linear('gates_event', config.event_size, gates)
    linear('gates_force', 1, gates, bias=False)
    linear('gates_hidden', config.lstm_size, gates, bias=False)
    linear('increment.0', config.lstm_size + config.event_size, config.mlp_size)
    linear('increment.2', config.mlp_size, 1)
    linear('context', MOMENTS, config.mlp_size, bias=False)
    shapes['deviation'] = (3,)
    if config.shear:
        shapes['shear.pull'], shapes['shear.turning'] = (2,), (len(TURNING_WIDTHS),)
        shapes['shear.unit'], shapes['shear.deviation'] = (3,), (3, 3)
    return shapes


def count_parameters(config: FgerConfig) -> int:
    """Return the number of trained parameters."""
    shapes = tensor_shapes(config)
    return sum(math.prod(shapes[name]) for name in shapes if name not in STATISTICS)


def operations_per_cycle(config: FgerConfig) -> int:
    """Return floating-point operations (2 per multiply-add) per frame interval of 40 ms."""
    shapes = tensor_shapes(config)
    sizes = {name: math.prod(shapes[name]) for name in shapes if name not in STATISTICS}
    per_frame = ('frame', 'shear', 'context')
    total = sum(size for name, size in sizes.items() if name.startswith(per_frame))
    per_window = sum(sizes.values()) - total
    # The event flow changes the normal force, and with `shear` three more values.
    per_cell = 2 * (4 if config.shear else 1) * config.grid_rows * config.grid_columns
    total += MOMENTS * per_cell
    per_window += per_cell
    return 2 * (total + per_window * 40_000 // config.window_us)

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counters that the camera itself keeps: what it sent, filtered and dropped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_driver.registers import Dvs, Module, Mux

if TYPE_CHECKING:
    from mixtac_driver.identity import Features
    from mixtac_driver.protocol import Protocol


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    """Totals since the logic was last reset; 0 where the logic does not count.

    Attributes:
        rows: Row addresses that the pixel array gave.
        columns: Column addresses, that is events, that it gave.
        dropped: Events that found the event read-out's buffer full.
        filtered_pixels: Events dropped by the pixel filters.
        filtered_background_activity: Events dropped by the background activity filter.
        filtered_refractory: Events dropped by the refractory period filter.
        external_input_dropped: Edges that found the way to the host blocked.
        dvs_dropped: Event words that found the way to the host blocked.
    """

    rows: int = 0
    columns: int = 0
    dropped: int = 0
    filtered_pixels: int = 0
    filtered_background_activity: int = 0
    filtered_refractory: int = 0
    external_input_dropped: int = 0
    dvs_dropped: int = 0

    @property
    def lost(self) -> int:
        """Everything that was dropped though nobody asked for it."""
        return self.dropped + self.external_input_dropped + self.dvs_dropped


def read_statistics(protocol: Protocol, features: Features) -> CameraStatistics:
    """Read the counters that a camera has.

    Args:
        protocol: Register access.
        features: Says which blocks count.

    Raises:
        UsbError: A request failed.
    """
    values: dict[str, int] = {}
    if features.dvs_statistics:
        values['rows'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_ROWS)
        values['columns'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_COLUMNS)
        values['dropped'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_DROPPED)
        if features.pixel_filter:
            values['filtered_pixels'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_PIXELS
            )
        if features.background_activity:
            values['filtered_background_activity'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_BACKGROUND_ACTIVITY
            )
            values['filtered_refractory'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_REFRACTORY
            )
    if features.mux_statistics:
        values['external_input_dropped'] = read_64(
            protocol, Module.MUX, Mux.STATISTICS_EXTERNAL_INPUT_DROPPED
        )
        values['dvs_dropped'] = read_64(protocol, Module.MUX, Mux.STATISTICS_DVS_DROPPED)
    return CameraStatistics(**values)


def read_64(protocol: Protocol, module: int, parameter: int) -> int:
    """Return a 64-bit counter: its upper half at `parameter`, its lower half at the next one.

    Raises:
        UsbError: A request failed.
    """
    upper = protocol.read(module, parameter)
    lower = protocol.read(module, parameter + 1)
    again = protocol.read(module, parameter)
    if again != upper:
        # The lower half overflowed in between; it cannot do so twice within a request.
        upper, lower = again, protocol.read(module, parameter + 1)
    return upper << 32 | lower

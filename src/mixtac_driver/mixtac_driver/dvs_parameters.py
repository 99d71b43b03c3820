# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the event pixels: region, filters, masked pixels."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.parameter_fields import number, switch
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class DvsParameters:
    """Events: all of it may change while the node runs."""

    dvs_enabled: bool = switch(True, 'Events on')
    background_activity_filter_enabled: bool = switch(
        False,
        'The camera drops events that no neighbour supports; off, because the force estimator was '
        'trained on all events',
    )
    background_activity_filter_time: int = number(
        8, 'Time within which a neighbour must have fired', 4095, '250 us'
    )
    refractory_period_enabled: bool = switch(False, 'The camera drops events soon after another')
    refractory_period_time: int = number(1, 'Time within which it does', 4095, '250 us')
    roi_start_col: int = number(0, 'First column of the events', 345)
    roi_start_row: int = number(0, 'First row of the events', 259)
    roi_end_col: int = number(345, 'Last column of the events', 345)
    roi_end_row: int = number(259, 'Last row of the events', 259)
    skip_enabled: bool = switch(False, 'The camera drops one event in so many')
    skip_events_every: int = number(5, 'Which one it drops', 255)
    polarity_flatten: bool = switch(False, 'All events become OFF')
    polarity_suppress: bool = switch(False, 'One polarity is dropped')
    polarity_suppress_type: bool = switch(False, 'Which: false OFF, true ON')
    dvs_pixel_mask: str = parameter(
        '',
        'Grey PNG image of 346 x 260 pixels: events of pixels that are not black are dropped, '
        'those of the eight brightest by the camera itself; empty for none',
    )
    hot_pixels_duration: float = parameter(
        2.0,
        'Time over which the service find_hot_pixels counts; keep the scene still',
        unit='s',
        minimum=0.1,
        maximum=4.0,
    )
    hot_pixels_minimum_rate: float = parameter(
        10.0,
        'Pixels with fewer events than this are not hot',
        unit='1/s',
        minimum=0.1,
        maximum=1e6,
    )
    hot_pixels_factor: float = parameter(
        10.0,
        'Pixels with fewer events than so many times the fourth noisiest pixel around them are '
        'not hot',
        minimum=1.0,
        maximum=1e6,
    )
    hot_pixels_file: str = parameter(
        '',
        'Where the service find_hot_pixels writes the mask, as an image for dvs_pixel_mask; empty '
        'for nowhere',
    )

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scenes without slip, for false alarms, and prescribed slips, for the detectors' curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.flicker import Flicker
from mixtac_sim.grasp.slip_scene import SlipScene, knock_profile
from mixtac_sim.presets import preset
from mixtac_slip_control.flow_guide import GuideMaker
from mixtac_slip_control.slip_features import SlipFeatures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_sim.grasp.slip_scene import SceneBlock
    from mixtac_slip_control.slip_features import SlipWindow
    from mixtac_slip_control.slip_settings import SlipSettings

QuietName = Literal['hold', 'load', 'flicker']
QUIET: tuple[QuietName, ...] = get_args(QuietName)

FORCE_N = 0.7
SWING_N = 0.3
"""The force of a slow load change goes up and down by so much [N]."""
SWING_HZ = (0.25, 0.5, 1.0)
"""As often as one of these, by the scene's seed [Hz]: up to 1 N/s."""
LOAD_RATIO = 0.6
"""Pull over what friction holds, where nothing may slip."""
FLICKER_HZ = 100.0
"""A lamp at 50 Hz mains shines alike in both half waves."""
FLICKER_DEPTHS = (0.08, 0.12, 0.15)
"""Ripple of the light in the sensor, one of these by the scene's seed: a lamp with 30 % ripple that
makes a quarter, 40 % or half of the light beside the sensor's own steady LED (estimates; an opaque
skin lets far less in). From about 20 % on the pixels fire by themselves and fill the readout."""
BLOCK_STEPS = 32


def quiet_blocks(
    name: QuietName, seconds: float, seed: int, preset_name: str
) -> Iterator[SceneBlock]:
    """Yield what a sensor sees of an object that does not slip, in blocks of 4 ms.

    Args:
        name: Steady hold, slow change of the load, or flickering lamps.
        seconds: Length [s].
        seed: Sensor and day.
        preset_name: How hard the sensor is.
    """
    scene = SlipScene(
        seed,
        seed,
        preset(preset_name),
        force_n=FORCE_N,
        load_ratio=LOAD_RATIO,
        flicker=flicker_of(seed) if name == 'flicker' else None,
    )
    still = np.zeros(BLOCK_STEPS)
    for block in range(round(1e6 * seconds / (BLOCK_STEPS * STEP_US))):
        force = None
        if name == 'load':
            t = 1e-6 * STEP_US * (block * BLOCK_STEPS + np.arange(BLOCK_STEPS) + 1)
            turns = SWING_HZ[seed % len(SWING_HZ)] * t
            force = FORCE_N + SWING_N * 0.5 * (1.0 - np.cos(2.0 * np.pi * turns))
        yield scene.advance(still, force)


def flicker_of(seed: int) -> Flicker:
    """Return the flicker of a scene."""
    phase = (0.618 * seed) % 1.0
    return Flicker(FLICKER_DEPTHS[seed % len(FLICKER_DEPTHS)], FLICKER_HZ, phase)


def slip_blocks(
    speed_mm_s: float, onset_s: float, seconds: float, seed: int, preset_name: str
) -> Iterator[SceneBlock]:
    """Yield what a sensor sees of an object that slips once, in blocks of 1 ms.

    Args:
        speed_mm_s: Speed of the slip [mm/s].
        onset_s: When it begins [s].
        seconds: Length [s].
        seed: Sensor and day.
        preset_name: How hard the sensor is.
    """
    scene = SlipScene(seed, seed, preset(preset_name), force_n=FORCE_N)
    return scene.play(knock_profile(speed_mm_s, onset_s, seconds - onset_s, seconds))


def windows_of(blocks: Iterator[SceneBlock], settings: SlipSettings) -> Iterator[SlipWindow]:
    """Yield the windows of a scene, as the controller's core cuts them.

    Args:
        blocks: Of the scene.
        settings: Of the controller.
    """
    features = SlipFeatures(settings.window_us, settings.guide)
    guides = GuideMaker(settings.guide)
    for block in blocks:
        for frame in block.frames:
            middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
            features.guide(guides.make(frame.intensity, middle))
        yield from features.push(block.events, block.end_us)

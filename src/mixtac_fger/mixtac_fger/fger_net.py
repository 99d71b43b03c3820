# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The estimator of FGER-Net, small version: compiled, without torch.

A frame measures the force absolutely, at the centre of its exposure (`mixtac_fger.moments`); events
measure its change since then (`mixtac_fger.force_path`). A frame that was exposed during a blow
averages different forces, and is not used for a correction.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mixtac_fger.config import (
    ARCHITECTURE,
    VERSION,
    ConfigError,
    FgerConfig,
    ModelError,
    tensor_shapes,
)
from mixtac_fger.contact import TouchMeter
from mixtac_fger.estimator import EncodedFrame, Estimator
from mixtac_fger.features import EventGuide, FramePreparation, WindowFeatures
from mixtac_fger.force_path import ForcePath, Shear, Shown
from mixtac_fger.reference import Reference
from mixtac_fger.weights import MODEL_REMEDY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_core.events.arrays import Events
    from mixtac_fger.displacement import SkinScale
    from mixtac_fger.estimator import Image
    from mixtac_fger.weights import Model


SPREAD_WINDOWS = 6
"""Windows over which the output follows a correction."""
DIVISORS = {'event.scale', 'frame.spread'}
"""Tensors by which inputs are divided."""
BLOW_WINDOWS = 3
"""Windows before and after the centre of an exposure in which a blow keeps a frame from correcting,
but never two frames in a row."""


class _Content(NamedTuple):
    """What is needed of a frame: what it shows, and how events are read by it."""

    shown: Shown
    guide: EventGuide


def checked_config(model: Model) -> FgerConfig:
    """Return the configuration of an FGER-Net model.

    Raises:
        ModelError: The model is of another architecture or version, its configuration cannot be
            used, or its tensors do not have the shapes that the configuration asks for.
    """
    found = (model.architecture, model.version)
    if found != (ARCHITECTURE, VERSION):
        raise ModelError(
            f'the weights are of {found[0]} version {found[1]}, but {ARCHITECTURE} version'
            f' {VERSION} is needed',
            remedy=MODEL_REMEDY,
        )
    try:
        config = FgerConfig.from_dict(model.config)
    except (ConfigError, ValueError, TypeError) as error:
        raise ModelError(
            f'the configuration of the weights cannot be used ({error})', remedy=MODEL_REMEDY
        ) from error
    wanted = tensor_shapes(config)
    shapes = {name: tuple(tensor.shape) for name, tensor in model.tensors.items()}
    for name in sorted({*wanted, *shapes}):
        if wanted.get(name) != shapes.get(name):
            raise ModelError(
                f'tensor {name} has shape {shapes.get(name)}, but {wanted.get(name)} is needed',
                remedy=MODEL_REMEDY,
            )
        if name in DIVISORS and not (model.tensors[name] > 0.0).all():
            raise ModelError(f'tensor {name} has values that are not above 0', remedy=MODEL_REMEDY)
    return config


def with_gain(model: Model, gain: float, sideways: float = 1.0, share: float = 0.0) -> Model:
    """Return an FGER-Net model whose forces are `gain` times those of `model`, deviations as well.

    Everything that makes a force is multiplied, everything that reads one is divided, so that the
    recurrent state runs through the same values as before. The relative deviations of the sideways
    force stay: its gain is not known better by presses.

    Args:
        model: Not changed.
        gain: Above 0.
        sideways: Further gain of sideways force and torsion, above 0; without effect where the
            model gives none.
        share: Share of the normal force in its deviation from now on; 0 leaves that of `model`,
            which for unknown sensors includes their unknown stiffness.

    Raises:
        ModelError: A gain is no such number, or as `checked_config`.
    """
    for each in (gain, sideways):
        if not 0.0 < each < float('inf'):
            raise ModelError(f'a gain of {each} is impossible', remedy='check the known forces')
    unit = gain * checked_config(model).force_unit
    tensors = {name: np.array(tensor) for name, tensor in model.tensors.items()}
    for name in ('frame.press', 'increment.2.weight', 'increment.2.bias'):
        tensors[name] *= np.float32(gain)
    tensors['gates_force.weight'] /= np.float32(gain)
    floor, old, _ = tensors['deviation']
    tensors['deviation'][:2] = gain * floor, share or old
    if 'shear.unit' in tensors:
        tensors['shear.unit'] *= np.float32(gain) * np.float32(sideways)
    return replace(model, config=model.config | {'force_unit': unit}, tensors=tensors)


class FgerEstimator(Estimator):
    """FGER-Net with its state.

    Args:
        model: Weights are copied.

    Attributes:
        config: Network configuration.
        path: The forces between frames, and the gains of the events.

    Raises:
        ModelError: As `checked_config`.
    """

    finds_contact = True
    reference: Reference

    def __init__(self, model: Model) -> None:
        self.config = config = checked_config(model)
        self.width, self.height, self.window_us = config.width, config.height, config.window_us
        self.force_unit = config.force_unit
        self.gives_deviation = bool(model.tensors['deviation'].any())
        self.reference = Reference(config)
        self._preparation = FramePreparation(config)
        self._encoding = threading.Lock()
        self.path = ForcePath(config, model.tensors)
        self._window_features = WindowFeatures(config)
        self._features, self._no_events = np.zeros((2, *self._window_features.shape), np.float32)
        self._guide: EventGuide | None = None
        self._passed = False
        self._touch: TouchMeter | None = None

    @property
    def flow(self) -> NDArray[np.float32]:
        """Flow of the latest window, [rows, columns, 2] of the event grid [px per threshold]."""
        return self._features[..., :2]

    @property
    def growth(self) -> float:
        """Growth of the gel since the reference, as a part of its length."""
        return self._preparation.growth

    def find_contacts(self, scale: SkinScale | None) -> None:
        """Measure displacement and contact of frames from now on; None ends it."""
        self._touch = None if scale is None else TouchMeter(self.config, scale)

    def encode(self, image: Image, mid_us: int) -> EncodedFrame | None:
        """Compare a frame with the reference; the number of its bits does not matter.

        Raises:
            ImageError: The image has another size.
        """
        with self._encoding:
            contrast = self._preparation.contrast(image)
            found = self.reference.add(contrast.coarse)
            if found is None:
                return None
            reference, number = found
            moments, picture = self._preparation.compare(contrast, reference)
            shown = self.path.measure(moments)
            content = _Content(shown, self._preparation.guide(contrast))
            coarse = contrast.coarse
            touch, meter = None, self._touch
            if meter is not None:
                # A contact that cannot be found costs no force.
                with contextlib.suppress(np.linalg.LinAlgError):
                    touch = meter.measure(self._preparation.grown, coarse)
            force = float(shown.value[0])
            return EncodedFrame(mid_us, force, number, content, coarse, picture, touch)

    def correct(self, frame: EncodedFrame, lag: int) -> None:
        """Correct the estimate at the centre of the exposure, and with it all later ones."""
        # In a blow the frame is a mixture of forces, and no force at its centre.
        self._passed = not self._passed and self.path.blow(lag, BLOW_WINDOWS)
        if self._passed:
            self.path.gains.forget_frame()
            return
        self.path.correct(frame.content.shown, lag, SPREAD_WINDOWS)
        self._guide = frame.content.guide

    def start_at(self, frame: EncodedFrame) -> None:
        """Start over at what the frame shows."""
        # A start at zero would take several frames to recover from, if in contact.
        self.path.start_at(frame.content.shown)
        self._guide = frame.content.guide

    def change_sensor(self) -> None:
        """Forget what was learned of the sensor."""
        self.path.change_sensor()

    def step(self, events: Events, end_us: int) -> tuple[float, float | None]:  # noqa: ARG002
        """Advance by one window; returns force and standard deviation [N]."""
        assert self._guide is not None  # noqa: S101  (the caller waits for a frame)
        light = self._window_features.compute(events, self._guide, self._features)
        features = self._no_events if light else self._features
        self.path.step(features)
        force, deviation = (each.tolist() for each in self.path.estimate())
        self.shear = None
        if self.config.shear and self.path.known:
            self.shear = Shear._make([*force[1:], max(deviation[1:3]), deviation[3]])
        return force[0], deviation[0] if self.gives_deviation else None

    def clear(self) -> None:
        """Forget the recurrent state."""
        self.shear = None
        self.path.clear()

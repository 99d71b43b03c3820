# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The estimator of FGER-Net, small version: compiled, without torch.

The network corrects its force F at once when a frame has been evaluated, 25 times a second. A
controller must not see these steps, which are not steps of the real force. The output therefore
follows a correction c over the next :math:`N` windows, by an equal share in each:

.. math:: f_t = F_t - p_t, \quad p_{t+1} = p_t (1 - 1/n_t), \quad n_t = N, N-1, \dots, 1

where the pending part p grows by c and n starts over when a frame corrects. The part beyond three
standard deviations is applied at once, because noise does not explain it. The deviation
:math:`\sigma` of the output is :math:`\sqrt{\sigma_t^2 + p_t^2}`.

While the force vibrates, the network loses the correction by a frame within one window, because
events of alternating sign pull F back to its earlier value. Frames then correct the output instead:
see `Vibration`. A frame that was exposed during a blow averages different forces, and is not used
for a correction.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mixtac_fger.config import (
    ARCHITECTURE,
    VERSION,
    ConfigError,
    FgerConfig,
    ModelError,
    count_parameters,
    operations_per_cycle,
    tensor_shapes,
)
from mixtac_fger.contact import TouchMeter
from mixtac_fger.estimator import EncodedFrame, Estimator
from mixtac_fger.features import EXPOSED_WINDOWS, EventGuide, FramePreparation, WindowFeatures
from mixtac_fger.frame_network import frame_maps, frame_step, frame_weights, row_scratch
from mixtac_fger.recurrent_network import RecurrentPath
from mixtac_fger.reference import Reference
from mixtac_fger.shear import Shear, ShearHead, Shown
from mixtac_fger.weights import MODEL_REMEDY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_core.events.arrays import Events
    from mixtac_fger.displacement import SkinScale
    from mixtac_fger.estimator import Image
    from mixtac_fger.weights import Model


SPREAD_WINDOWS = 10
"""Windows over which the output follows a correction; half the time between two frames."""
DIVISORS = {'event.scale', 'frame.scale', 'frame.spread'}
"""Tensors by which inputs are divided."""
BLOW_WINDOWS = 3
"""Windows before and after the centre of an exposure in which a blow keeps a frame from correcting,
but never two frames in a row."""
UNCONFIRMED_SHARE = 0.3
"""Standard deviation of increments that no frame has confirmed yet, as a part of their sum."""
TIMING_WINDOWS = 4.0
"""Standard deviation of the time of a force [windows]."""
SLOPE_WINDOWS = 5
"""Windows over which the slope of the force is averaged."""
STEEPEST_N = 0.05
"""Largest slope that counts [N per window]."""
REST_DEVIATION = 0.003
"""Standard deviation of the force of a sensor at rest, for a gel of usual stiffness [N]."""
SPREAD_DEVIATIONS = 3.0
"""Standard deviations of the force beyond which a correction is applied at once."""


class _Content(NamedTuple):
    """What is needed of a frame: f_frame, what events are multiplied with, and the shear shown."""

    feature: NDArray[np.float32]
    guide: EventGuide
    shear: Shown | None


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


class Vibration:
    r"""Recognises a force that vibrates, and follows its mean by frames.

    A vibration begins when the sum of the increments has reversed `TURNS` times by `SWING_N` or
    more within the latest `SPAN` windows. It ends when fewer than `TURNS_LEFT` reversals are left,
    or when there was none in `QUIET` windows. A vibration of 50 Hz reverses twelve times; rebounds
    have rest between them. During a vibration the output is

    .. math:: f_t = F_t + o, \quad o \leftarrow o + k (F_{frame} - \bar F - o),

    where the mean is over the exposure; k is 1 for the first frame and `SHARE` for each after it.
    The deviation follows the phase of the vibration, but the error does not. The reported deviation
    is therefore at least its mean over a frame interval, and the difference to the frames adds to
    it. The constants are from 40 simulated trials of 5 s (vibrations, blows, and without either).

    Args:
        unit: What one newton of the constants is; see `FgerConfig.force_unit`.

    Attributes:
        active: Whether the force vibrates.
        offset: Correction that frames add to the force [N].
        misfit: Root mean square of the difference between frames and corrected force [N].
    """

    SWING_N: Final = 0.02
    SPAN: Final = 60
    TURNS: Final = 12
    TURNS_LEFT: Final = 9
    QUIET: Final = 10
    SHARE: Final = 0.5
    MEAN_WINDOWS: Final = 20

    def __init__(self, unit: float) -> None:
        self._swing = unit * self.SWING_N
        self._turns: deque[int] = deque()
        self.offset = self.misfit = self._mean_deviation = 0.0
        self._compared = False
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.active = False
        self._turns.clear()
        self._window, self._way = 0, 1.0
        self._sum = self._farthest = 0.0
        self.end()

    def step(self, increment: float) -> None:
        """Add the change of the force in a window, without corrections [N]."""
        self._window += 1
        self._sum += increment
        ahead = self._way * (self._sum - self._farthest)
        if ahead > 0.0:
            self._farthest = self._sum
        elif ahead < -self._swing:
            self._way, self._farthest = -self._way, self._sum
            self._turns.append(self._window)
        if self._turns and self._turns[-1] <= self._window - self.QUIET:
            self._turns.clear()
        while self._turns and self._turns[0] <= self._window - self.SPAN:
            self._turns.popleft()
        self.active = len(self._turns) >= (self.TURNS_LEFT if self.active else self.TURNS)

    def correct(self, difference: float) -> float:
        """Add a frame and return the change of the offset [N].

        Args:
            difference: The frame's force, less the mean of F in its exposure [N].
        """
        change = difference - self.offset
        if self._compared:
            self.misfit = math.sqrt(self.misfit**2 + self.SHARE * (change**2 - self.misfit**2))
            change *= self.SHARE
        self._compared = True
        self.offset += change
        return change

    def deviation(self, deviation: float) -> float:
        """Return the standard deviation, given that of the network in each window [N]."""
        mean = self._mean_deviation or deviation
        self._mean_deviation = mean + (deviation - mean) / self.MEAN_WINDOWS
        return math.hypot(max(deviation, mean), self.misfit)

    def end(self) -> float:
        """Return the offset of a vibration that has ended, and forget it."""
        offset, self.offset = self.offset, 0.0
        self.misfit = self._mean_deviation = 0.0
        self._compared = False
        return offset


CALIBRATED_DEVIATION = 0.3
"""Factor of the network's deviations once the gain of the sensor is known.

The deviations of a model for unknown sensors include their unknown stiffness.
"""


def with_gain(model: Model, gain: float, deviation: float = 1.0) -> Model:
    """Return an FGER-Net model whose forces are `gain` times those of `model`, deviations as well.

    The relative deviations of the sideways force stay: its gain is not known better by presses.

    Everything that makes a force is multiplied, everything that reads one is divided, so that the
    recurrent state runs through the same values as before.

    Args:
        model: Not changed.
        gain: Above 0.
        deviation: Factor of the deviation of the normal force beside it.

    Raises:
        ModelError: The gain is no such number, or as `checked_config`.
    """
    unit = gain * _checked(model, gain).force_unit
    tensors = {name: np.array(tensor) for name, tensor in model.tensors.items()}
    for layer in ('increment.2', 'correction.2', 'frame.head'):
        for kind in ('weight', 'bias'):
            tensors[f'{layer}.{kind}'] *= np.float32(gain)
    tensors['gates_force.weight'] /= np.float32(gain)
    tensors['correction.0.weight'][:, 0] /= np.float32(gain)
    if 'deviation.scale' in tensors:
        tensors['deviation.hidden.weight'][:, -2:] /= np.float32(gain)
        tensors['deviation.scale'] *= np.float32(gain * deviation)
    if 'shear.unit' in tensors:
        tensors['shear.unit'] *= np.float32(gain)
    return replace(model, config=model.config | {'force_unit': unit}, tensors=tensors)


def with_sideways_gain(model: Model, gain: float) -> Model:
    """Return an FGER-Net model whose sideways forces and torsion are `gain` times those of `model`.

    Args:
        model: Not changed.
        gain: Above 0.

    Raises:
        ModelError: The gain is no such number, the model has no sideways force, or as
            `checked_config`.
    """
    if not _checked(model, gain).shear:
        raise ModelError('the model gives no sideways force', remedy=MODEL_REMEDY)
    unit = model.tensors['shear.unit'] * np.float32(gain)
    return replace(model, tensors={**model.tensors, 'shear.unit': unit})


def _checked(model: Model, gain: float) -> FgerConfig:
    if not 0.0 < gain < float('inf'):
        raise ModelError(f'a gain of {gain} is impossible', remedy='check the known forces')
    return checked_config(model)


class FgerEstimator(Estimator):
    """FGER-Net with its state.

    Args:
        model: Weights are copied.

    Attributes:
        config: Network configuration.
        parameters: Number of trained parameters.
        operations: Floating-point operations per frame interval of 40 ms (2 per multiply-add).
        path: The recurrent network, and the gain of its increments.

    Raises:
        ModelError: As `checked_config`.
    """

    finds_contact = True
    reference: Reference

    def __init__(self, model: Model) -> None:
        self.config = config = checked_config(model)
        self.width, self.height, self.window_us = config.width, config.height, config.window_us
        self.force_unit = config.force_unit
        self.gives_deviation = config.deviation_size > 0
        self.parameters, self.operations = count_parameters(config), operations_per_cycle(config)
        self.reference = Reference(config)
        self._weights = frame_weights(model.tensors, config)
        self._maps = frame_maps(config)
        self._scratch = row_scratch(config)
        self._preparation = FramePreparation(config)
        self._encoding = threading.Lock()
        self.path = RecurrentPath(config, model.tensors)
        self._window_features = WindowFeatures(config)
        self._features, self._no_events = np.zeros((2, *self._window_features.shape), np.float32)
        self._guide: EventGuide | None = None
        self._pending_n, self._pending_windows = 0.0, 0
        self._passed = False
        self._output = self._slope = 0.0
        self._vibration = Vibration(config.force_unit)
        self._rest_deviation = REST_DEVIATION * config.force_unit
        self._touch: TouchMeter | None = None
        self._shear = ShearHead(config, model.tensors) if config.shear else None

    @property
    def flow(self) -> NDArray[np.float32]:
        """Flow of the latest window, [rows, columns, 2] of the event grid [px per threshold]."""
        return self._features[..., :2]

    def find_contacts(self, scale: SkinScale | None) -> None:
        """Measure displacement and contact of frames from now on; None ends it."""
        self._touch = None if scale is None else TouchMeter(self.config, scale)

    @property
    def shear(self) -> Shear | None:
        """Sideways force and torsion after the latest window; None where they are unknown."""
        return None if self._shear is None else self._shear.value

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
            inputs = self._preparation.network_input(contrast, reference)
            picture = self._preparation.picture(reference)
            moments = self._preparation.moments()
            feature = np.empty(self.config.feature_size, np.float32)
            force = frame_step(inputs, moments, self._weights, self._maps, self._scratch, feature)
            guide = self._preparation.guide(contrast)
            shear = None if self._shear is None else self._shear.measure(feature)
            content = _Content(feature, guide, shear)
            coarse = contrast.coarse
            touch, meter = None, self._touch
            if meter is not None:
                # A contact that cannot be found costs no force.
                with contextlib.suppress(np.linalg.LinAlgError):
                    touch = meter.measure(reference, coarse)
            return EncodedFrame(mid_us, float(force), number, content, coarse, picture, touch)

    def correct(self, frame: EncodedFrame, lag: int) -> None:
        """Correct the estimate at the centre of the exposure, and with it all later ones."""
        if self._vibration.active:
            then = self.path.mean(lag, EXPOSED_WINDOWS)
            self._pending_n += self._vibration.correct(frame.force - then)
        else:
            # In a blow the frame is a mixture of forces, and no force at its centre.
            self._passed = not self._passed and self.path.blow(lag, BLOW_WINDOWS)
            if self._passed:
                self.path.forget_frame()
                return
            self._pending_n += self.path.correct(frame.content.feature, lag)
        self._pending_windows = SPREAD_WINDOWS
        self._see(frame.content)
        if self._shear is not None:
            self._shear.correct(frame.content.shear, lag, SPREAD_WINDOWS)

    def _see(self, content: _Content) -> None:
        """Let events be read by a frame from now on."""
        self._guide = content.guide
        self.path.see(content.feature)

    def start_at(self, frame: EncodedFrame) -> None:
        """Start over at the frames-only force."""
        self._pending_n = self._slope = 0.0
        self._vibration.clear()
        # A start at zero would take several frames to recover from, if in contact.
        self._see(frame.content)
        self.path.start_at(frame.force)
        self._output = frame.force
        if self._shear is not None:
            self._shear.clear()
            self._shear.correct(frame.content.shear, 0)

    def change_sensor(self) -> None:
        """Forget what was learned of the sensor."""
        self.path.change_sensor()

    def step(self, events: Events, end_us: int) -> tuple[float, float | None]:  # noqa: ARG002
        """Advance by one window; returns force and standard deviation [N]."""
        assert self._guide is not None  # noqa: S101  (the caller waits for a frame)
        light = self._window_features.compute(events, self._guide, self._features)
        path, vibration = self.path, self._vibration
        vibrated = vibration.active
        features = self._no_events if light else self._features
        increment = path.step(features)
        if vibrated:
            # Frames lead the mean, and correct the path no more.
            path.confirm()
        force, deviation = path.force, path.deviation
        if deviation is not None:
            unconfirmed = UNCONFIRMED_SHARE * path.moved
            deviation = math.hypot(deviation, self._rest_deviation, unconfirmed)
        vibration.step(increment)
        if vibration.active and not vibrated:
            # The network has forgotten the frames; what the gain has added stays.
            self._pending_n = 0.0
            path.shift(force - path.network_force)
            path.confirm()
        if vibrated:
            force += vibration.offset
            if deviation is not None:
                deviation = vibration.deviation(deviation)
            if not vibration.active:
                path.shift(vibration.end())
        if self._shear is not None:
            self._shear.step(features)
        if self._pending_n:
            self._follow(math.inf if deviation is None else SPREAD_DEVIATIONS * deviation)
        before, self._output = self._output, force - self._pending_n
        self._slope += (self._output - before - self._slope) / SLOPE_WINDOWS
        if deviation is not None:
            slope = min(abs(self._slope), STEEPEST_N * self.config.force_unit)
            deviation = math.hypot(deviation, self._pending_n, TIMING_WINDOWS * slope)
        return self._output, deviation

    def _follow(self, largest: float) -> None:
        """Let the output follow the latest correction, at once where it is too large [N]."""
        self._pending_n = min(max(self._pending_n, -largest), largest)
        self._pending_n -= self._pending_n / self._pending_windows
        self._pending_windows -= 1

    def clear(self) -> None:
        """Forget the recurrent state."""
        self._pending_n = self._output = self._slope = 0.0
        self._vibration.clear()
        self.path.clear()
        if self._shear is not None:
            self._shear.clear()

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The interface and the registry of estimators, and the type of an estimate.

A package registers an architecture by an entry point of the group `mixtac.estimators`, named like
the architecture in the weight file:

    'mixtac.estimators': ['my_network = my_package.live:MyEstimator']

`MyEstimator` is an `Estimator` that is made from a `mixtac_fger.weights.Model`.
`mixtac_fger.streaming.ForceEstimator` follows the stream and calls it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from mixtac_fger.config import ModelError
from mixtac_fger.validity import Reason

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_core.events.arrays import Events
    from mixtac_fger.contact import Touch
    from mixtac_fger.contact_tracking import Contact
    from mixtac_fger.displacement import SkinScale
    from mixtac_fger.force_path import Shear
    from mixtac_fger.reference import Reference
    from mixtac_fger.validity import PictureFigures
    from mixtac_fger.weights import Model, ModelCard

    Image = NDArray[np.uint8] | NDArray[np.uint16]


ESTIMATORS: Final = 'mixtac.estimators'
"""Entry-point group of architectures."""


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """A frame as an estimator uses it.

    Attributes:
        mid_us: Centre of the exposure, camera clock [us].
        force: Frames-only force [N].
        reference: `Reference.number` of the reference it was compared with, 0 without one.
        content: Private data of the estimator.
        contrast: Coarse log contrast, float32 [rows, columns]; None if the architecture does not
            compute it; frames are then not compared with events.
        picture: Comparison with the reference; None without one.
        touch: Displacement of the beads and the contact; None unless asked for.
    """

    mid_us: int
    force: float
    reference: int
    content: Any
    contrast: NDArray[np.float32] | None = None
    picture: PictureFigures | None = None
    touch: Touch | None = None


class Estimator(ABC):
    """One architecture with its weights and its state; windows are processed in order of time.

    `encode` may be called from a second thread; all other methods are called from one thread.

    Attributes:
        width: Columns of the sensor [px].
        height: Rows of the sensor [px].
        window_us: Length of a window [us]; one force per window.
        gives_deviation: Whether `step` returns a standard deviation.
        finds_contact: Whether encoded frames can have a `touch`.
        force_unit: Force that one newton in the training stands for [N]; not 1 after a calibration.
        reference: The no-contact reference; None if the architecture needs none.
        shear: Sideways force and torsion after the latest window; None where they are unknown.
    """

    width: int
    height: int
    window_us: int
    gives_deviation: bool = False
    finds_contact: bool = False
    force_unit: float = 1.0
    reference: Reference | None = None
    shear: Shear | None = None

    @abstractmethod
    def encode(self, image: Image, mid_us: int) -> EncodedFrame | None:
        """Return a frame as the estimator uses it; None while the reference is incomplete.

        Args:
            image: Intensity, [height, width]; uint8, or uint16 with the camera's bits left-aligned.
            mid_us: Centre of the exposure, camera clock [us].

        Raises:
            ImageError: The image has another size.
        """

    @abstractmethod
    def correct(self, frame: EncodedFrame, lag: int) -> None:
        """Correct the estimate by a frame that has become available.

        Args:
            frame: From `encode`.
            lag: Windows between the last estimate and the centre of the exposure.
        """

    @abstractmethod
    def start_at(self, frame: EncodedFrame) -> None:
        """Restart the estimate from a frame, possibly in contact."""

    @abstractmethod
    def step(self, events: Events, end_us: int) -> tuple[float, float | None]:
        """Advance by one window and return the force and its standard deviation [N].

        It is called only after a frame has been passed to `correct` or `start_at`.

        Args:
            events: Events of the window, camera clock.
            end_us: End of the window, camera clock [us].
        """

    @abstractmethod
    def clear(self) -> None:
        """Reset the recurrent state, including the force. The latest frame is kept."""

    @property
    def growth(self) -> float:
        """Growth of the gel since the reference, as a part of its length; 0 if it is unknown."""
        return 0.0

    @property
    def flow(self) -> NDArray[np.float32]:
        """Flow of the latest window, [rows, columns, 2] of the event grid [px per threshold]."""
        return np.zeros((1, 1, 2), np.float32)

    def find_contacts(self, scale: SkinScale | None) -> None:  # noqa: B027 - optional
        """Measure the contact of all further frames, if `finds_contact`; None disables this."""

    def change_sensor(self) -> None:  # noqa: B027 - optional
        """Reset everything that was learned about the sensor."""


def open_estimator(model: Model) -> Estimator:
    """Return a new estimator of a model, by the architecture that its weight file names.

    Raises:
        ModelError: No package registers the architecture, or its version, configuration or tensors
            do not fit.
    """
    found = entry_points(group=ESTIMATORS)
    chosen = [each for each in found if each.name == model.architecture]
    if not chosen:
        known = ', '.join(sorted({each.name for each in found})) or 'none'
        raise ModelError(
            f'no estimator is installed for the architecture {model.architecture!r}'
            f' (installed: {known})',
            remedy='install the package that provides it (mixtac_learning for fger_paper), or use'
            ' the model that comes with mixtac_fger',
        )
    try:
        make = chosen[0].load()
    except ImportError as error:
        raise ModelError(
            f'the estimator of {model.architecture!r} cannot be loaded ({error})',
            remedy='install what it needs; fger_paper needs PyTorch',
        ) from error
    estimator: Estimator = make(model)
    return estimator


class Estimate(NamedTuple):
    """The force at the end of a window, with its uncertainty and validity.

    Attributes:
        end_us: End of the window, camera clock [us].
        force: Normal force [N].
        deviation: Standard deviation of the force [N]; None if the model estimates none.
        frame_age_us: Time from the centre of the latest frame's exposure to the end of the window
            [us].
        complete: Whether all packets of the window arrived.
        saturated: Whether the sensor's readout has probably lost events because there were so many.
        reason: Why the force cannot be trusted; `Reason.TRUSTED` if nothing was found.
        contact: State and place of the contact; None unless asked for.
        shear: Sideways force and torsion; None where they are unknown.
    """

    end_us: int
    force: float
    deviation: float | None = None
    frame_age_us: int = 0
    complete: bool = True
    saturated: bool = False
    reason: Reason = Reason.TRUSTED
    contact: Contact | None = None
    shear: Shear | None = None

    @property
    def valid(self) -> bool:
        """Whether the force can be trusted."""
        return self.reason is Reason.TRUSTED


def fill_quality(message: Any, estimate: Estimate) -> None:  # noqa: ANN401
    """Write everything but the header of a `ForceQuality` message."""
    message.force = estimate.force
    message.deviation = -1.0 if estimate.deviation is None else estimate.deviation
    message.frame_age = estimate.frame_age_us * 1e-6
    message.complete, message.saturated = estimate.complete, estimate.saturated
    message.valid, message.reason = estimate.valid, int(estimate.reason)
    shear = estimate.shear
    message.sideways_known = message.torque_known = shear is not None
    message.sideways_deviation = -1.0 if shear is None else shear.deviation
    message.torque_deviation = -1.0 if shear is None else shear.torque_deviation


@dataclass(slots=True)
class EstimatorStatus:
    """Counters of the live estimator since its creation, and its present state.

    Attributes:
        withheld: Windows without a force although there was an estimate: no packet covered them, or
            the latest frame was too old.
        saturated: Windows with so many events that the sensor has probably lost some.
        frames: Frames applied.
        frames_dropped: Frames replaced by a newer one before they were encoded or applied.
        frames_off_clock: Frames not used because their exposure is not near the time of the events.
        bad_frames: Frames that are damaged, or of a size that the model does not read (background
            only).
        problem: Why the latest of these was refused.
        late_events: Events dropped because their window was closed.
        resets: Times the clock went backwards or the state was not finite.
        reason: Why windows give no forces; empty if they do.
        validity: Why the latest force cannot be trusted, by name; `TRUSTED` if it can.
        zero_drift: Force that frames show while nothing touches the sensor [N].
        gel_growth: Growth of the gel since the reference, as a part of its length; it is corrected.
    """

    withheld: int = 0
    saturated: int = 0
    frames: int = 0
    frames_dropped: int = 0
    frames_off_clock: int = 0
    bad_frames: int = 0
    problem: str = ''
    late_events: int = 0
    resets: int = 0
    reason: str = ''
    validity: str = Reason.TRUSTED.name
    zero_drift: float = 0.0
    gel_growth: float = 0.0


SERIAL_KEY = 'sensor_serial'
"""Key in `ModelCard.training` of the camera's serial number, for a model adapted to one sensor."""
CALIBRATED_KEY = 'calibrated'
"""Key in `ModelCard.training` of a calibration of the gain of one sensor."""


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """Known properties of the camera.

    Attributes:
        width: Columns of its frames [px]; 0 while unknown.
        height: Rows [px].
        serial: Serial number, empty while unknown.
    """

    width: int = 0
    height: int = 0
    serial: str = ''


def check_camera(estimator: Estimator, card: ModelCard, camera: CameraFacts) -> None:
    """Reject a camera that the model was not made for; unknown properties are not checked.

    Raises:
        ModelError: Size or serial number do not fit.
    """
    wanted = (estimator.width, estimator.height)
    if camera.width and (camera.width, camera.height) != wanted:
        raise ModelError(
            f'the camera has {camera.width} x {camera.height} pixels, the model reads'
            f' {wanted[0]} x {wanted[1]}',
            remedy='choose a model of this size',
        )
    serial = str(card.training.get(SERIAL_KEY, ''))
    if serial and camera.serial and serial != camera.serial:
        raise ModelError(
            f'the model was adapted to sensor {serial}, the camera is {camera.serial}',
            remedy='choose a general model, and calibrate it with "mixtac calibrate-force"',
        )

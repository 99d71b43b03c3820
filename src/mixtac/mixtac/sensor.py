# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A sensor as an object: the latest force and pictures, without ROS.

It is made of the same parts as the ROS nodes: the driver's source and supervisor, the live
estimator with its checks, and the writer of bags.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac.latest import LONG_MS, Latest, NotOpenError, SensorError
from mixtac.virtual import VirtualProcess
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import warm_up as warm_up_codec
from mixtac_core.events.frames import PICTURE_KERNELS
from mixtac_core.node.files import state_file
from mixtac_core.node.parameters import build
from mixtac_core.node.process import compiling
from mixtac_core.recordings.messages import left_aligned
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import warm_up as warm_up_mask
from mixtac_driver.supervisor import SourceKind, State, Supervisor, make_source, source_kind
from mixtac_fger.estimator import CameraFacts, check_camera, open_estimator
from mixtac_fger.parameters import FgerParameters
from mixtac_fger.reference import reference_name, stored_reference
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.validity import Reason
from mixtac_fger.weights import find_model, read_model

if TYPE_CHECKING:
    from mixtac_core.events.readings import Frame
    from mixtac_driver.camera import CameraBatch
    from mixtac_fger.estimator import EncodedFrame

USB: Final = 'usb'
VIRTUAL: Final = 'virtual'


class Reading(NamedTuple):
    """The force at the end of a window of 2 ms, with its uncertainty and validity.

    Attributes:
        stamp_us: End of the window, camera clock [us since the Unix epoch].
        force: Normal force [N]; NaN if it is withheld because it is not valid.
        deviation: Standard deviation of the force [N]; NaN if the model estimates none.
        valid: Whether the force can be trusted.
        reason: Reason why the force is not valid; `Reason.TRUSTED` if it is.
        frame_age_s: Time from the latest frame to the end of the window [s].
    """

    stamp_us: int
    force: float
    deviation: float
    valid: bool
    reason: Reason
    frame_age_s: float

    def __str__(self) -> str:
        """Return force and deviation, or why there is no valid force."""
        text = f'{self.force:.3f} N +- {self.deviation:.3f} N'
        return text if self.valid else f'{text}, not valid: {self.reason.text}'


class Picture(NamedTuple):
    """A frame that the estimator has used.

    Attributes:
        stamp_us: Middle of the exposure, camera clock [us since the Unix epoch].
        image: Intensity, uint16 [height, width], the camera's 10 bits left-aligned.
        difference: Log contrast minus the log contrast without contact, float32 [rows, columns],
            one value per 4 x 4 pixels; None if the model does not compute it.
    """

    stamp_us: int
    image: NDArray[np.uint16]
    difference: NDArray[np.float32] | None


WAITING: Final = 8
"""Frames that wait to be encoded; the estimator keeps fewer."""


class Sensor:
    """A tactile sensor; use it in a `with` statement, or call `open` and `close`.

    `read`, `async_read` and `read_latest` return forces as LeRobot's cameras return images. `read`
    waits for the next force, `async_read` waits for a force that was not returned yet, and
    `read_latest` does not wait. `pictures` has the same three methods for frames. All methods may
    be called from any thread.

    Without a stored reference, the force of a camera is not valid until the sensor has been touched
    and released and `tare` has been called, as with the ROS node. Virtual sensors and recordings
    begin without contact: their first still frames are the zero.

    Args:
        source: `virtual` for a simulated sensor without contact, `virtual:press` for a simulated
            sensor that repeats the profile `press` (`mixtac_sim.world.profiles`), `usb` for the
            attached camera, `usb:SERIAL` for one of several cameras, a device string of the driver,
            or the path of a recording.
        model: Weight file, or name of a shipped model; empty for the model of `fger`.
        driver: Settings of the camera and of playback.
        fger: Settings of the estimator.

    Attributes:
        pictures: Frames that the estimator has used: `Latest[Picture]`.
        virtual: Process of the virtual sensor that this object has started; None for other sources.
            Its `true_force` returns the simulated force at the stamp of a reading.

    Raises:
        ParameterError: A value of `driver` or `fger` is not allowed.
    """

    def __init__(
        self,
        source: Path | str = USB,
        *,
        model: str = '',
        driver: DriverParameters | None = None,
        fger: FgerParameters | None = None,
    ) -> None:
        self.source = str(source)
        self._parameters = build(DriverParameters, asdict(driver) if driver else {})
        self._fger = build(FgerParameters, asdict(fger) if fger else {})
        if model:
            self._fger = replace(self._fger, model=model)
        self._closing = ExitStack()
        self._opening = threading.RLock()
        # `tare` may be called from any thread, while the source's thread feeds the estimator.
        self._estimating = threading.Lock()
        self._supervisor: Supervisor | None = None
        self.virtual: VirtualProcess | None = None
        self.pictures: Latest[Picture] = Latest('picture', self._check, self._reason)
        self._forces: Latest[Reading] = Latest('force', self._check, self._reason)

    def __enter__(self) -> Sensor:
        """Open the sensor."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the sensor."""
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the sensor is open."""
        return self._supervisor is not None

    @property
    def serial(self) -> str:
        """Serial number of the camera; empty while closed."""
        return self._identity.serial if self.is_open else ''

    def open(self) -> None:
        """Load the model, open the source and start; compiling takes seconds the very first time.

        Raises:
            ModelError: The weights are missing, damaged, or do not fit the camera.
            NoCameraError: No such camera is attached.
            SensorError: The sensor is open already, or the virtual sensor does not start.
            MixtacError: The source or the bag cannot be opened.
        """
        with self._opening:
            if self.is_open:
                raise SensorError('the sensor is open already', remedy='call close() first')
            self.pictures.clear()
            self._forces.clear()
            with ExitStack() as closing:
                self._supervisor = self._start(closing)
                self._closing = closing.pop_all()

    def close(self) -> None:
        """Stop and release the sensor; has no effect on a closed sensor."""
        with self._opening:
            self._supervisor = None
            self._closing.close()

    def read(self, timeout_ms: float = LONG_MS) -> Reading:
        """Wait for a force that is newer than this call; see `Latest.read`."""
        return self._forces.read(timeout_ms)

    def async_read(self, timeout_ms: float = 200) -> Reading:
        """Return the latest force that it has not returned yet; see `Latest.async_read`."""
        return self._forces.async_read(timeout_ms)

    def read_latest(self, max_age_ms: float = 500) -> Reading:
        """Return the latest force at once, unless it is too old; see `Latest.read_latest`."""
        return self._forces.read_latest(max_age_ms)

    def tare(self) -> None:
        """Set the present force to zero; with a camera, also store the reference for later.

        Raises:
            TareError: The sensor is in contact, has too few still frames, or saw no release since
                the start.
            NotOpenError: The sensor is closed.
        """
        self._check()
        with self._estimating:
            self._feed.tare()
            reference, name = self._feed.reference, self._settings.reference
            if name and reference is not None:
                reference.save(state_file(name))

    def _start(self, closing: ExitStack) -> Supervisor:
        path = find_model(self._fger.model)
        model = read_model(path)
        device, _, scenario = self.source.partition(':')
        if device == VIRTUAL and not scenario.startswith('/'):
            # It compiles while this process does.
            self.virtual = VirtualProcess(scenario)
            closing.callback(self.virtual.close)
        for kernels, run_once in (
            ('the packet codec', warm_up_codec),
            (PICTURE_KERNELS, partial(warm_up, open_estimator(model))),
            ('the pixel mask', warm_up_mask),
        ):
            with compiling(kernels):
                run_once()
        parameters = self._driver_parameters()
        kind = source_kind(parameters.device)
        settings = self._fger
        if kind is not SourceKind.CAMERA:
            settings = replace(settings, assume_free=True)
        self._driver = driver = DriverSettings(parameters)
        camera, pixel_filter = driver.camera_settings()
        self._source = source = make_source(camera, pixel_filter=pixel_filter)
        source.open()
        closing.callback(source.close)
        identity = source.status().identity
        assert identity is not None  # noqa: S101  (it was opened)
        self._identity = identity
        width, height = size = identity.geometry.event_size
        driver.use_size(size)
        estimator = open_estimator(model)
        check_camera(estimator, model.card, CameraFacts(width, height, serial=identity.serial))
        if not settings.reference and kind is SourceKind.CAMERA:
            settings = replace(settings, reference=reference_name(identity.serial))
        stored_reference(settings.reference, estimator.reference)
        options = settings.estimator_options() | {'assume_free': settings.assume_free}
        self._settings = settings
        self._feed = ForceEstimator(estimator, background_frames=True, **options)
        closing.callback(self._feed.close)
        self._images: deque[tuple[int, NDArray[np.uint16]]] = deque(maxlen=WAITING)
        self._shown: EncodedFrame | None = None
        supervisor = Supervisor(
            source,
            parameters,
            on_start=self._refuse_another_camera,
            on_batch=self._on_batch,
            on_error=lambda _line: None,
        )
        closing.callback(supervisor.stop)
        supervisor.start()
        return supervisor

    def _driver_parameters(self) -> DriverParameters:
        device, _, serial = self.source.partition(':')
        if device == USB:
            return replace(self._parameters, device=DriverParameters.device, serial=serial)
        device = self.virtual.device if self.virtual else self.source
        return replace(self._parameters, device=device)

    def _check(self) -> None:
        """Raise an error if no further reading can arrive."""
        supervisor = self._supervisor
        if supervisor is None:
            raise NotOpenError(
                f'the sensor {self.source!r} is not open',
                remedy='call open() or use it in a with statement',
            )
        if supervisor.failure is not None:
            raise supervisor.failure
        if supervisor.state is State.ENDED:
            raise SensorError('the recording has ended', remedy='open it again')

    def _reason(self) -> str:
        """Return why no force comes; empty if unknown."""
        supervisor = self._supervisor
        return supervisor.error or self._feed.status().reason if supervisor else ''

    def _refuse_another_camera(self) -> None:
        identity = self._source.status().identity
        if identity and identity.serial != self._identity.serial:
            raise SensorError(
                f'camera {identity.serial} replaces {self._identity.serial}',
                remedy='close the sensor and open it again: each camera has its own zero',
            )

    def _on_batch(self, batch: CameraBatch) -> None:
        decoded, origin_us = batch.decoded, batch.origin.us
        for frame in decoded.frames:
            self._on_frame(frame, origin_us)
        kept = self._driver.mask.keep(decoded.events)
        # The driver's arrays are overwritten by the next batch.
        events = Events(kept.t + origin_us, kept.x.copy(), kept.y.copy(), kept.polarity.copy())
        with self._estimating:
            estimates = self._feed.push_events(events, batch.time_us)
            self._show_frame()
        if estimates:
            latest = estimates[-1]
            shown = latest.valid or self._settings.invalid_force == 'publish'
            reading = Reading(
                stamp_us=latest.end_us,
                force=latest.force if shown else math.nan,
                deviation=math.nan if latest.deviation is None else latest.deviation,
                valid=latest.valid,
                reason=latest.reason,
                frame_age_s=latest.frame_age_us * 1e-6,
            )
            self._forces.put(reading)

    def _on_frame(self, frame: Frame, origin_us: int) -> None:
        image, mid_us = left_aligned(frame.image), frame.middle_us + origin_us
        self._images.append((mid_us, image))
        with self._estimating:
            self._feed.push_frame(image, mid_us)
        control = self._source.control
        if control is not None:
            exposure_us = frame.exposure_cycles / self._identity.clocks.adc
            self._driver.follow(frame, exposure_us, control)

    def _show_frame(self) -> None:
        frame, reference = self._feed.frame, self._feed.reference
        if frame is None or frame is self._shown:
            return
        self._shown = frame
        difference = None
        if frame.contrast is not None and reference is not None and reference.array is not None:
            difference = frame.contrast - reference.array
        for mid_us, image in self._images:
            if mid_us == frame.mid_us:
                self.pictures.put(Picture(mid_us, image, difference))

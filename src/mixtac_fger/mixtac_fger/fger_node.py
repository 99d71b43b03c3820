# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node `fger`: event packets and images in, normal force at 500 Hz out."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from mixtac_core.events.codec import warm_up as warm_up_codec
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.frames import PICTURE_KERNELS
from mixtac_core.events.packets import CodecError, read_packet
from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import ERROR, OK, DiagnosticsPublisher, Status
from mixtac_core.node.files import state_file
from mixtac_core.node.process import freeze_loaded
from mixtac_core.node.topics import stamp_to_us
from mixtac_core.recordings.messages import set_header
from mixtac_fger.config import ModelError
from mixtac_fger.contact_messages import ContactOutputs
from mixtac_fger.estimator import (
    CameraFacts,
    check_camera,
    fill_quality,
    open_estimator,
)
from mixtac_fger.live_feed import LiveFeed, feed_diagnosis
from mixtac_fger.parameters import FgerParameters
from mixtac_fger.reference import TareError, reference_name, stored_reference
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.weights import MODEL_REMEDY, find_model, read_model
from mixtac_msgs.msg import ForceQuality

if TYPE_CHECKING:
    from lifecycle_msgs.srv import ChangeState
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image, TimeReference

    from mixtac_fger.estimator import Estimator
    from mixtac_fger.weights import Model


class FgerNode(BaseNode, LifecycleNode):  # type: ignore[misc]
    """Estimates force while active.

    Configure loads the model and checks it against the camera; activate loads the reference and
    starts.
    Without a stored reference the forces are not valid until ~/tare, unless `assume_free` is set.
    """

    def __init__(self) -> None:
        super().__init__('fger')
        self._settings = declare(self, FgerParameters, self._change)
        self._to_start = self._settings.autostart
        self._refusal: MixtacError = ModelError('the estimator failed', remedy='see the log')
        self._model: Model | None = None
        self._estimator: Estimator | None = None
        self._feed: LiveFeed | None = None
        self._camera = CameraFacts()
        self._misfit = ''
        self._inputs: list[object] = []
        self._lens = 0.0, (0.0, 0.0)
        self._message = topics.WrenchWriter(self._settings.frame_id)
        self._diagnostics = DiagnosticsPublisher(self, self._settings.model, self._status)
        self.create_service(Trigger, '~/tare', answering(self._on_tare))
        self.subscribe_topic(topics.CAMERA_CLOCK, self._on_clock)
        self.subscribe_topic(topics.CAMERA_INFO, self._on_camera_info)

    def check(self) -> None:
        """Configure and activate the node once, with `autostart`, unless somebody has already.

        Raises:
            MixtacError: It refuses.
        """
        start, self._to_start = self._to_start and self._model is None, False
        success = TransitionCallbackReturn.SUCCESS
        steps = self.trigger_configure, self.trigger_activate
        if start and any(step() != success for step in steps):
            raise self._refusal

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Load and check the model, compile what runs in real time."""
        settings = self._settings
        try:
            model = read_model(find_model(settings.model))
            estimator = open_estimator(model)
            check_camera(estimator, model.card, self._camera)
        except MixtacError as error:
            return self._refuse(error)
        with self._diagnostics.compiling('the packet codec'):
            warm_up_codec()
        with self._diagnostics.compiling(PICTURE_KERNELS):
            forces = warm_up(open_estimator(model))
        if not forces:
            return self._refuse(ModelError('it gives no force', remedy=MODEL_REMEDY))
        self._model, self._estimator, self._misfit = model, estimator, ''
        self._diagnostics.hardware_id = settings.model
        return TransitionCallbackReturn.SUCCESS

    def _refuse(self, error: MixtacError) -> TransitionCallbackReturn:
        self._refusal = error
        self.get_logger().error(f'{self._settings.model}: {error}')
        return TransitionCallbackReturn.FAILURE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start estimating, from the stored reference if there is one."""
        assert self._model is not None  # noqa: S101  (the state machine configures first)
        settings = self._settings
        self._estimator = open_estimator(self._model)
        try:
            stored_reference(self._reference_file(settings), self._estimator.reference)
        except MixtacError as error:
            return self._refuse(error)
        options = settings.estimator_options() | {'assume_free': settings.assume_free}
        estimator = ForceEstimator(self._estimator, background_frames=True, **options)
        self._force = self.publish_topic(topics.FORCE, managed=True)
        self._quality = self.publish_topic(topics.FORCE_QUALITY, managed=True)
        self._contact = settings.contact_settings(*self._lens)
        self._outputs = ContactOutputs(self, settings)
        self._feed = LiveFeed(estimator, deadline_s=settings.deadline)
        freeze_loaded()
        compressed = settings.image_transport == 'compressed'
        frames = topics.IMAGE_COMPRESSED if compressed else topics.IMAGE_RAW
        self._inputs = [
            self.subscribe_topic(topics.EVENTS, self._on_events, raw=True),
            self.subscribe_topic(frames, self._on_image),
        ]
        return super().on_activate(state)

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop estimating and forget the reference, unless it is stored."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the model; after a defect, this allows another start."""
        self.close()
        self._model = self._estimator = None
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_error = on_cleanup

    def close(self) -> None:
        """End the subscriptions, the publishers of estimates and the frame thread."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        if self._feed is not None:
            self._feed.close()
            self._feed = None
            self._outputs.close()
            for publisher in (self._force, self._quality):
                self.destroy_lifecycle_publisher(publisher)

    def _LifecycleNodeMixin__on_change_state(  # noqa: N802 - rclpy's own name for it
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse a transition that is not possible now; rclpy would end the process."""
        handle = super()._LifecycleNodeMixin__on_change_state
        try:
            return handle(request, response)
        except rclpy_implementation.RCLError as error:
            wanted = request.transition.label or request.transition.id
            text = ' '.join(str(error).split())
            self.get_logger().error(f'transition {wanted} is not possible now ({text})')
            response.success = False
            return response

    def _change(self, wanted: FgerParameters) -> None:
        """Apply new parameters, or refuse all of them.

        Raises:
            MixtacError: The model is in use or missing, or the reference cannot be used.
        """
        before = self._settings
        if wanted.model != before.model:
            if self._model is not None:
                raise ModelError(
                    f'model {wanted.model} cannot replace {before.model} in a configured node',
                    remedy='clean up the node, set the model, configure it',
                )
            read_model(find_model(wanted.model))
        if wanted.reference != before.reference:
            state_file(wanted.reference or 'none')
            if self._feed is not None:
                self._feed.estimator.load_reference(self._reference_file(wanted))
        if self._feed is not None:
            self._feed.deadline_s = wanted.deadline
            for name, value in wanted.estimator_options().items():
                setattr(self._feed.estimator, name, value)
        self._message = topics.WrenchWriter(wanted.frame_id)
        self._settings = wanted

    def _on_camera_info(self, info: CameraInfo) -> None:
        focal, column, row = map(float, (info.k[0], info.k[2], info.k[5]))
        if 0.0 < focal < math.inf:
            self._lens = focal, (column, row)
            self._contact = self._settings.contact_settings(*self._lens)
        self._check_camera(replace(self._camera, width=info.width, height=info.height))

    def _on_clock(self, message: TimeReference) -> None:
        self._check_camera(replace(self._camera, serial=message.source))

    def _check_camera(self, camera: CameraFacts) -> None:
        before, self._camera = self._camera, camera
        if camera == before or self._model is None or self._estimator is None:
            return
        if camera.serial != before.serial and self._feed is not None:
            estimator = self._feed.estimator
            if before.serial:
                self.get_logger().warning(f'camera {camera.serial} replaces {before.serial}')
                estimator.change_camera()
            name = '' if self._settings.reference else self._reference_file(self._settings)
            try:
                estimator.load_reference(name)
            except MixtacError as error:
                self.get_logger().warning(f'{error}')
        try:
            check_camera(self._estimator, self._model.card, camera)
            self._misfit = ''
        except MixtacError as error:
            self._misfit = str(error)
            self.get_logger().error(self._misfit)

    def _reference_file(self, settings: FgerParameters) -> str:
        """Return the name of the reference's file; empty if there is to be none."""
        if settings.reference or settings.assume_free:
            return settings.reference
        return reference_name(self._camera.serial)

    def _on_events(self, message: bytes) -> None:
        """Publish the forces of a packet: bytes as the middleware has them."""
        feed = self._feed
        if feed is None or self._misfit:
            return
        try:
            packet = read_packet(message)
        except CodecError as error:
            feed.refuse(str(error))
            return
        estimates = feed.packet(packet, time.time_ns() - packet.stamp_ns)
        if not estimates:
            return
        for estimate in estimates:
            if estimate.valid or self._settings.invalid_force == 'publish':
                x, y, torque = (0.0, 0.0, 0.0) if estimate.shear is None else estimate.shear[:3]
                wrench = (x, y, estimate.force, 0.0, 0.0, torque)
                self._force.publish(self._message.serialised(1000 * estimate.end_us, wrench))
        now_ns = time.time_ns()
        # Off the critical path from here on.
        feed.published(len(estimates), packet.stamp_ns, now_ns)
        if self._quality.get_subscription_count():
            for estimate in estimates:
                frame_id, stamp_ns = self._settings.frame_id, 1000 * estimate.end_us
                quality = set_header(ForceQuality(), stamp_ns, frame_id)
                fill_quality(quality, estimate)
                self._quality.publish(quality)
        self._outputs.publish(feed.estimator, estimates, self._settings, self._contact)

    def _on_image(self, message: Image | CompressedImage) -> None:
        if self._feed is not None and not self._misfit:
            self._feed.image(message, stamp_to_us(message.header.stamp))

    def _on_tare(self, _request: Trigger.Request) -> str:
        if self._feed is None:
            raise TareError('the node is not active', remedy='activate it first')
        self._feed.estimator.tare()
        reference, name = self._feed.estimator.reference, self._reference_file(self._settings)
        if not name or reference is None:
            return 'the present force is zero now'
        reference.save(state_file(name))
        return f'the present force is zero now; reference written to {state_file(name)}'

    def _status(self) -> Status:
        if self._misfit:
            return Status(ERROR, self._misfit)
        if self._feed is None:
            return Status(OK, 'not active: no force is published')
        found = self._feed.status()
        return Status(*feed_diagnosis(found), found.values)


main = partial(run, FgerNode)

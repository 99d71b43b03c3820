# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node `fger`: event packets and images in, normal force at 500 Hz out."""

from __future__ import annotations

import gc
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import CameraInfo, Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_events.errors import MixtacError
from mixtac_events.packets import CodecError, SerialisedPacket, read_packet
from mixtac_fger.estimator import CameraFacts, check_camera
from mixtac_fger.frames import load_reference, save_reference
from mixtac_fger.live_feed import ForceMessage, LiveFeed, judge_feed
from mixtac_fger.parameters import FgerParameters
from mixtac_fger.streaming import warm_up
from mixtac_fger.weights import find_model, load_model
from mixtac_msgs.msg import ForceQuality
from mixtac_node.base_node import (
    QOS_EVENTS,
    QOS_FORCE,
    QOS_LATCHED,
    QOS_SENSOR,
    BaseNode,
    declare,
    run,
)
from mixtac_node.diagnostics import ERROR, OK, DiagnosticsPublisher, Status
from mixtac_node.stamps import stamp_to_ns, stamp_to_us, us_to_stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.estimator import Estimate
    from mixtac_fger.weights import LoadedModel


class FgerNode(BaseNode, LifecycleNode):  # type: ignore[misc]
    """Estimates force while active.

    Configure loads the model and the reference and checks them against the camera; activate starts.
    Without a stored reference the sensor must be untouched for the first frames.
    """

    def __init__(self) -> None:
        super().__init__('fger')
        self._settings = declare(self, FgerParameters, self._change)
        self._model: LoadedModel | None = None
        self._reference: NDArray[Any] | None = None
        self._feed: LiveFeed | None = None
        self._camera = CameraFacts()
        self._misfit = ''
        self._inputs: list[object] = []
        self._force: Any = None
        self._quality: Any = None
        self._message = ForceMessage(self._settings.frame_id)
        self._diagnostics = DiagnosticsPublisher(self, self._settings.model, self._status)
        self.create_service(Trigger, '~/tare', self._tare)
        self.create_subscription(TimeReference, 'camera_clock', self._on_clock, QOS_LATCHED)
        self._info: object | None = None
        self._ask_camera()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load and check the model, compile what runs in real time."""
        self._ask_camera()
        try:
            model = load_model(find_model(self._settings.model))
            check_camera(model, self._camera)
            self._reference = self._stored_reference(model)
        except MixtacError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        warm_up(model)
        self._model, self._misfit = model, ''
        self._force = self.create_lifecycle_publisher(WrenchStamped, 'force', QOS_FORCE)
        self._quality = self.create_lifecycle_publisher(ForceQuality, 'force_quality', QOS_FORCE)
        self._diagnostics.hardware_id = self._settings.model
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start estimating."""
        assert self._model is not None  # noqa: S101  (the state machine configures first)
        settings = self._settings
        self._message = ForceMessage(settings.frame_id)
        self._feed = LiveFeed(
            self._model,
            settings.contact_threshold,
            settings.force_scale,
            longest_without_frame_us=round(settings.longest_without_frame * 1e6),
            deadline_s=settings.deadline,
        )
        if self._reference is not None:
            self._feed.estimator.use_reference(self._reference)
        # What has been loaded stays: a search through all of it for garbage takes many windows.
        gc.collect()
        gc.freeze()
        self._inputs = [
            self.create_subscription(EventPacket, 'events', self._on_events, QOS_EVENTS, raw=True),
            self.create_subscription(Image, 'image_raw', self._on_image, QOS_SENSOR),
        ]
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop estimating and forget the reference, unless it is stored."""
        self.close()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the model."""
        self._end()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop estimating for good."""
        self._end()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the unconfigured state after a defect, so that a new start is possible."""
        self._end()
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def close(self) -> None:
        """End the subscriptions and the frame thread."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        if self._feed is not None:
            self._feed.close()
            self._feed = None

    def _end(self) -> None:
        self.close()
        for publisher in (self._force, self._quality):
            if publisher is not None:
                self.destroy_publisher(publisher)
        self._force = self._quality = self._model = None

    def _stored_reference(self, model: LoadedModel) -> NDArray[Any] | None:
        path = Path(self._settings.reference).expanduser()
        if not self._settings.reference or not path.exists():
            return None
        return load_reference(path, model.config)

    def _change(self, wanted: FgerParameters) -> None:
        self._settings = wanted

    def _ask_camera(self) -> None:
        if self._info is None:
            self._info = self.create_subscription(
                CameraInfo, 'camera_info', self._on_camera_info, QOS_SENSOR
            )

    def _on_camera_info(self, info: CameraInfo) -> None:
        whole = (0, 0, info.width, info.height), (0, 0, 0, 0)
        region = info.roi
        part = (region.x_offset, region.y_offset, region.width, region.height)
        cut = max(info.binning_x, info.binning_y) > 1 or part not in whole
        self._take(replace(self._camera, width=info.width, height=info.height, cut=cut))

    def _on_clock(self, message: TimeReference) -> None:
        self._take(replace(self._camera, serial=message.source))

    def _take(self, camera: CameraFacts) -> None:
        if camera == self._camera:
            return
        self._camera = camera
        if self._model is None:
            return
        try:
            check_camera(self._model, camera)
            self._misfit = ''
        except MixtacError as error:
            self._misfit = str(error)
            self.get_logger().error(self._misfit)

    def _on_events(self, message: bytes | EventPacket) -> None:
        """Take a packet: bytes from the middleware, a message from within the process."""
        feed = self._feed
        if feed is None or self._misfit:
            return
        try:
            packet = read_packet(message) if isinstance(message, bytes) else message
        except CodecError as error:
            feed.refuse(str(error))
            return
        estimates = feed.packet(packet)
        if not estimates:
            return
        for estimate in estimates:
            self._force.publish(self._message.serialised(estimate.end_us, estimate.force))
        now_ns = time.time_ns()
        # What follows is not waited for.
        arrival_ns = (
            packet.stamp_ns
            if isinstance(packet, SerialisedPacket)
            else stamp_to_ns(packet.header.stamp)
        )
        feed.published(len(estimates), arrival_ns, now_ns)
        if self._quality.get_subscription_count():
            for estimate in estimates:
                self._quality.publish(self._quality_of(estimate))

    def _quality_of(self, estimate: Estimate) -> ForceQuality:
        message = ForceQuality()
        message.header.stamp = us_to_stamp(estimate.end_us)
        message.header.frame_id = self._settings.frame_id
        message.force = estimate.force
        message.deviation = -1.0 if estimate.deviation is None else estimate.deviation
        message.frame_age = estimate.frame_age_us * 1e-6
        message.complete, message.saturated = estimate.complete, estimate.saturated
        return message

    def _on_image(self, message: Image) -> None:
        if self._feed is not None and not self._misfit:
            self._feed.image(message, stamp_to_us(message.header.stamp))

    def _tare(self, _request: Trigger.Request, reply: Trigger.Response) -> Trigger.Response:
        try:
            if self._feed is None:
                raise MixtacError('the node is not active: activate it first')  # noqa: TRY301
            self._feed.estimator.tare()
            stored = self._store_reference(self._feed)
        except MixtacError as error:
            reply.success, reply.message = False, str(error)
        else:
            reply.success, reply.message = True, 'the present state is zero now' + stored
        return reply

    def _store_reference(self, feed: LiveFeed) -> str:
        reference = feed.estimator.reference
        if not self._settings.reference or reference is None or self._model is None:
            return ''
        path = Path(self._settings.reference).expanduser()
        save_reference(path, reference, self._model.config)
        self._reference = reference
        return f'; written to {path}'

    def _status(self) -> Status:
        if self._info is not None and self._camera.width:
            # Here, not in its callback: an entity is not destroyed while it is being served.
            self.destroy_subscription(self._info)
            self._info = None
        if self._misfit:
            return Status(ERROR, self._misfit)
        if self._feed is None:
            return Status(OK, 'not active: no force is published')
        found = self._feed.status()
        level, message = judge_feed(found, self._settings.stale_frame_age)
        values = asdict(found)
        del values['lately']
        values['camera_checked'] = bool(self._camera.width)
        return Status(level, message, values.pop('estimator') | values)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(FgerNode, args)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node `fger`: event packets and images in, normal force at 500 Hz out."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from mixtac_events.errors import MixtacError
from mixtac_fger.fger_parameters import FgerParameters
from mixtac_fger.live_feed import FeedStatus, LiveFeed
from mixtac_fger.model_files import find_model
from mixtac_fger.warm_up import warm_up
from mixtac_fger.weights import load_model
from mixtac_node.base_node import (
    QOS_EVENTS,
    QOS_FORCE,
    QOS_SENSOR,
    OverridableQos,
    declare,
    run,
    stamp_to_us,
    us_to_stamp,
)
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status

if TYPE_CHECKING:
    from mixtac_fger.weights import LoadedModel


class FgerNode(OverridableQos, LifecycleNode):  # type: ignore[misc]
    """Estimates force while active.

    Configure loads and checks the model; activate starts with the no-contact reference, so the
    sensor must be untouched for the first frames.
    """

    def __init__(self) -> None:
        super().__init__('fger')
        self._settings = declare(self, FgerParameters, self._change)
        self._model: LoadedModel | None = None
        self._feed: LiveFeed | None = None
        self._subscriptions_: list[object] = []
        self._publisher: Any = None
        self._diagnostics = DiagnosticsPublisher(self, self._settings.model, self._status)
        self.create_service(Trigger, '~/tare', self._tare)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the model and compile what runs in real time."""
        try:
            self._model = load_model(find_model(self._settings.model))
        except MixtacError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        warm_up(self._model)
        self._publisher = self.create_lifecycle_publisher(WrenchStamped, 'force', QOS_FORCE)
        self._diagnostics.hardware_id = self._settings.model
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start estimating."""
        assert self._model is not None  # noqa: S101  (the state machine configures first)
        settings = self._settings
        self._feed = LiveFeed(self._model, settings.contact_threshold, settings.force_scale)
        self._subscriptions_ = [
            self.create_subscription(EventPacket, 'events', self._on_events, QOS_EVENTS),
            self.create_subscription(Image, 'image_raw', self._on_image, QOS_SENSOR),
        ]
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop estimating and forget the reference."""
        self.close()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the model."""
        self.close()
        self.destroy_publisher(self._publisher)
        self._model = None
        return super().on_cleanup(state)

    def close(self) -> None:
        """End the subscriptions and the frame thread."""
        for subscription in self._subscriptions_:
            self.destroy_subscription(subscription)
        self._subscriptions_ = []
        if self._feed is not None:
            self._feed.close()
            self._feed = None

    def _change(self, wanted: FgerParameters) -> None:
        self._settings = wanted

    def _on_events(self, message: EventPacket) -> None:
        if self._feed is not None:
            for end_us, force in self._feed.packet(message):
                self._publish(end_us, force)

    def _publish(self, end_us: int, force: float) -> None:
        message = WrenchStamped()
        message.header.stamp = us_to_stamp(end_us)
        message.header.frame_id = self._settings.frame_id
        message.wrench.force.z = force
        self._publisher.publish(message)

    def _on_image(self, message: Image) -> None:
        if self._feed is not None:
            self._feed.image(message, stamp_to_us(message.header.stamp))

    def _tare(self, _request: Trigger.Request, reply: Trigger.Response) -> Trigger.Response:
        try:
            if self._feed is None:
                raise MixtacError('the node is not active: activate it first')  # noqa: TRY301
            self._feed.estimator.tare()
        except MixtacError as error:
            reply.success, reply.message = False, str(error)
        else:
            reply.success, reply.message = True, 'the present state is zero now'
        return reply

    def _status(self) -> Status:
        if self._feed is None:
            return Status(OK, 'not active: no force is published')
        found = self._feed.status()
        level, message = judge(found, self._settings.stale_frame_age)
        values = asdict(found)
        return Status(level, message, values.pop('estimator') | values)


def judge(found: FeedStatus, stale_s: float) -> tuple[int, str]:
    """Return the level and the message that a status deserves.

    Args:
        found: Figures of the active estimator.
        stale_s: Age from which frames are too old [s].
    """
    if found.estimator.reason:
        problem = f'; {found.problem}' if found.problem else ''
        return WARN, found.estimator.reason + problem
    if found.rate_hz == 0.0:
        return WARN, 'no force in the last second: no event packets arrive'
    age_s = found.estimator.frame_age_us * 1e-6
    if age_s > stale_s:
        return WARN, f'latest frame is {age_s:.1f} s old: the force drifts'
    if found.problem:
        return WARN, found.problem
    return OK, 'estimating'


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(FgerNode, args)


if __name__ == '__main__':
    sys.exit(main())

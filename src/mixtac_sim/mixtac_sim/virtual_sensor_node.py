# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor as a node: camera on a socket, reference force and truth on topics."""

from __future__ import annotations

import dataclasses
from functools import partial
from threading import Event, Thread
from typing import Any, Final

from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import ERROR, OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.topics import ns_to_stamp
from mixtac_msgs.srv import Touch
from mixtac_sim.live.touch import TouchControl
from mixtac_sim.live.virtual_sensor import SimulationProcess, make_virtual_sensor
from mixtac_sim.parameters import VirtualSensorParameters
from mixtac_sim.usb.server import UsbServer, check_free
from mixtac_sim.usb.wire import default_socket_path
from mixtac_sim.world.effects import preset
from mixtac_sim.world.instruments import WrenchSamples
from mixtac_sim.world.profiles import make_profile

# Samples go out in small batches, as real force sensors' drivers do: it saves wake-ups.
PUBLISH_PERIOD_S: Final = 0.004
WARNING_PERIOD_S: Final = 5.0
WARNING_US: Final = 100_000


class VirtualSensorNode(BaseNode, Node):  # type: ignore[misc]
    """Runs a virtual sensor, serves its camera and publishes the measurements of a bench.

    Topics: the reference wrench (its own clock) and ``truth/wrench`` (host time). The service
    ``~/play`` plays the scenario, ``~/touch`` presses, pulls, drops or releases an object.

    Args:
        process: Where the sensor is simulated.

    Raises:
        MixtacError: A parameter is not allowed, or the socket is taken.
    """

    def __init__(self, process: SimulationProcess) -> None:
        super().__init__('virtual_sensor')
        self._settings = declare(self, VirtualSensorParameters, self._change)
        self._plays = 0
        self._stop = Event()
        path = self._settings.socket or default_socket_path()
        check_free(path)
        self._scenario(self._settings)
        self._sensor = make_virtual_sensor(
            device_seed=self._settings.device_seed,
            seed=self._settings.seed,
            skew_ppm=self._settings.skew_ppm,
            preset=preset(self._settings.preset),
            process=process,
        )
        self._reference = self.publish_topic(
            topics.REFERENCE_WRENCH, name=self._settings.reference_topic
        )
        self._truth = self.publish_topic(topics.TRUTH_WRENCH)
        self._reference_writer = topics.WrenchWriter(topics.REFERENCE_FRAME)
        self._truth_writer = topics.WrenchWriter(topics.CONTACT_FRAME)
        self._touch = TouchControl(self._sensor)
        self.create_service(Trigger, '~/play', answering(lambda _: self._play()))
        self.create_service(Touch, '~/touch', answering(self._on_touch))
        clock = self._settings.publish_clock
        self._time = self.create_publisher(Clock, '/clock', 10) if clock else None
        self._sensor.start()
        # The first step compiles: a driver that came before would miss the data.
        self._server = UsbServer(self._sensor.device, path)
        self._lost_us = 0
        self._diagnostics = DiagnosticsPublisher(self, self._sensor.device.serial, self._status)
        self._thread = Thread(target=self._publish_all, name='publish', daemon=True)
        self._thread.start()
        self.get_logger().info(
            f'virtual sensor {self._sensor.device.serial} on {path}; device:=virtual reads it'
        )

    def close(self) -> None:
        """End threads, remove the socket."""
        self._stop.set()
        self._thread.join(5.0)
        self._sensor.close()
        self._server.close()

    def _scenario(self, parameters: VirtualSensorParameters) -> Any:  # noqa: ANN401
        # Each repetition is another trial, as on a bench.
        seed = parameters.seed + self._plays
        return make_profile(
            parameters.scenario,
            seed,
            parameters.seconds,
            preset=preset(parameters.preset),
        )

    def _change(self, parameters: VirtualSensorParameters) -> None:
        self._scenario(parameters)
        self._settings = parameters

    def _play(self) -> str:
        settings = self._settings
        lead_us = round(settings.lead_seconds * 1e6)
        self._sensor.play(self._scenario(settings), lead_us=lead_us)
        self._plays += 1
        return f'playing {settings.scenario} for {settings.seconds} s in {settings.lead_seconds} s'

    def _on_touch(self, request: Touch.Request) -> str:
        names = request.get_fields_and_field_types()
        return self._touch.touch(**{name: getattr(request, name) for name in names})

    def _publish_all(self) -> None:
        while not self._stop.wait(PUBLISH_PERIOD_S):
            for batch in self._sensor.take_reference():
                publish_wrenches(self._reference, batch, self._reference_writer)
            for batch in self._sensor.take_truth():
                publish_wrenches(self._truth, batch, self._truth_writer)
            if self._time is not None:
                self._time.publish(Clock(clock=ns_to_stamp(self._sensor.time_ns())))
            self._play_if_due()

    def _play_if_due(self) -> None:
        state = self._sensor.state()
        first = self._settings.play_on_start and not self._plays and state.streaming
        again = self._settings.loop and self._plays and not state.playing
        if first or again:
            self._play()

    def _status(self) -> Status:
        state = self._sensor.state()
        losses = self._sensor.device.losses
        if state.lost_us > self._lost_us + WARNING_US:
            self._lost_us = state.lost_us
            self.get_logger().warning(
                'the host is too slow: simulated time stopped, and stamps of the camera and the '
                f'reference lie {1e-6 * state.lost_us:.1f} s behind the host clock',
                throttle_duration_sec=WARNING_PERIOD_S,
            )
        if not state.running:
            return Status(ERROR, 'SIMULATED sensor, stopped by an internal error: see the log', {})
        lossless = not any(losses.values()) and not state.lost_us
        doing = f'playing {self._settings.scenario}' if state.playing else 'idle'
        host = 'camera read by a host' if state.streaming else 'camera not read'
        return Status(
            OK if lossless else WARN,
            f'SIMULATED sensor, {doing}, {host}'
            + ('' if lossless else '; host too slow, see lost_us and losses'),
            {
                'simulated': True,
                'scenario': self._settings.scenario,
                'plays': self._plays,
                'socket': self._server.path,
                **dataclasses.asdict(state),
                **losses,
            },
        )


def publish_wrenches(publisher: Any, batch: WrenchSamples, writer: topics.WrenchWriter) -> None:  # noqa: ANN401
    """Publish the samples of a batch."""
    for stamp_ns, wrench in zip(batch.t_ns.tolist(), batch.wrench.tolist(), strict=True):
        publisher.publish(writer.serialised(stamp_ns, wrench))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    # Forked while this process has one thread.
    return run(partial(VirtualSensorNode, SimulationProcess()), args)

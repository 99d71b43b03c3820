# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own on a virtual camera, and a node that listens to it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import rclpy
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from virtual_scene import Scene

from mixtac_sim.usb.server import UsbServer

COMMAND = [sys.executable, '-m', 'mixtac_driver.node.driver_node', '--ros-args']


class Graph:
    """A scene, the driver on it, and a node that listens."""

    def __init__(self, tmp_path, env):
        self.env = env
        self.path = str(tmp_path / 'camera.sock')
        self.scene = self.server = self.process = None
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('listener', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got = {}

    def plug_in(self):
        self.scene = Scene()
        self.server = UsbServer(self.scene.device, self.path)

    def unplug(self):
        self.server.close()
        self.scene.close()
        self.server = None

    def start_driver(self, *parameters):
        assignments = [f'device:=virtual:{self.path}', *parameters]
        args = [word for each in assignments for word in ('-p', each)]
        self.process = subprocess.Popen(
            [*COMMAND, *args], env=self.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    def listen(self, kind, topic, qos):
        self.got[topic] = []
        self.node.create_subscription(kind, topic, self.got[topic].append, qos)

    def spin_until(self, condition, seconds=20.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, {k: len(v) for k, v in self.got.items()}
            assert self.process.poll() is None, self.process.stdout.read().decode()
            self.executor.spin_once(timeout_sec=0.1)

    def latest_diagnostics(self):
        for array in reversed(self.got['/diagnostics']):
            for status in array.status:
                if status.name == 'mixtac/driver':
                    return status
        return None

    def call(self, kind, name, request):
        client = self.node.create_client(kind, f'/mixtac/driver/{name}')
        self.spin_until(client.service_is_ready)
        future = client.call_async(request)
        self.spin_until(future.done)
        return future.result()

    def trigger(self, name):
        return self.call(Trigger, name, Trigger.Request())

    def change(self, **values):
        parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.call(SetParametersAtomically, 'set_parameters_atomically', request).result

    def stop_driver(self):
        self.process.send_signal(signal.SIGINT)
        output, _ = self.process.communicate(timeout=15)
        return self.process.returncode, output.decode()

    def close(self):
        if self.process is not None and self.process.poll() is None:
            # Killed, it would still be a peer of the node here, whose end then crashes at times.
            self.process.terminate()
            try:
                self.process.communicate(timeout=15)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self.server is not None:
            self.unplug()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

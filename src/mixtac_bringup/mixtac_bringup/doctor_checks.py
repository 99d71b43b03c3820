# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac doctor` looks at beyond the camera: ROS, the model, the virtual sensor."""

from __future__ import annotations

import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from mixtac_driver.backend import check_device
from mixtac_driver.doctor.finding import Finding, Level, ok
from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

VIRTUAL = 'virtual'
DISTRIBUTIONS = {'3': 'Humble', '7': 'Jazzy', '9': 'Kilted'}
"""ROS distribution by major version of rclpy."""
PROBE = (
    'import rclpy; from importlib.metadata import version; '
    'from rclpy.utilities import get_rmw_implementation_identifier as rmw; '
    "print(version('rclpy'), rmw())"
)
PROBE_TIMEOUT_S = 60.0
SAFE_DOMAINS = range(102)
"""Above, the ports of DDS run into those that Linux gives to outgoing connections."""
DEVICE_SEED, SEED = 1001, 1001


def check_ros(environment: Mapping[str, str]) -> list[Finding]:
    """Say which ROS there is and how nodes will find each other.

    Args:
        environment: Variables of the process.
    """
    return [_check_rclpy(environment), check_domain(environment)]


def _check_rclpy(environment: Mapping[str, str]) -> Finding:
    name, remedy = 'ROS 2', 'source the workspace: . tools/env.sh, or install/setup.bash'
    command = [sys.executable, '-c', PROBE]
    try:
        run = subprocess.run(
            command,
            env=dict(environment),
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding(name, Level.ERROR, f'import rclpy took over {PROBE_TIMEOUT_S:g} s', remedy)
    if run.returncode:
        reason = (run.stderr.strip().splitlines() or ['no reason was given'])[-1]
        return Finding(name, Level.ERROR, f'rclpy cannot be imported: {reason}', remedy)
    version, rmw = run.stdout.split()[-2:]
    named = environment.get('ROS_DISTRO') or DISTRIBUTIONS.get(version.partition('.')[0], 'unknown')
    found = f'{named}, rclpy {version}, {rmw}'
    return ok(name, found, distribution=named.lower(), rclpy=version, rmw=rmw)


def check_domain(environment: Mapping[str, str]) -> Finding:
    """Say which other nodes will be seen."""
    name, text = 'ROS domain', environment.get('ROS_DOMAIN_ID') or '0'
    reach = environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'not restricted'
    remedy = f'export ROS_DOMAIN_ID=N with N from 0 to {SAFE_DOMAINS[-1]}'
    if not text.isdigit():
        return Finding(name, Level.ERROR, f'ROS_DOMAIN_ID={text} is no number', remedy)
    if int(text) not in SAFE_DOMAINS:
        found = f'ROS_DOMAIN_ID={text}: its ports may be taken by outgoing connections'
        return Finding(name, Level.WARN, found, remedy)
    return ok(name, f'{text}, discovery range {reach}', domain=int(text), range=reach)


def check_model() -> Finding:
    """Say whether the model that comes with the estimator can be loaded."""
    # Torch takes seconds to load: only when it is needed.
    from mixtac_fger.model_files import DEFAULT_MODEL, find_model
    from mixtac_fger.weights import load_model

    path = find_model(DEFAULT_MODEL)
    try:
        load_model(path)
    except MixtacError as error:
        found, _, remedy = str(error).rpartition(': ')
        return Finding('model', Level.ERROR, found or str(error), remedy)
    return ok('model', str(path))


def check_virtual_sensor() -> Finding:
    """Say whether the virtual sensor is installed."""
    try:
        check_device(VIRTUAL)
    except MixtacError as error:
        remedy = 'build the workspace with mixtac_sim: make setup'
        return Finding('virtual sensor', Level.WARN, str(error), remedy)
    return ok('virtual sensor', 'installed; use it with --device virtual')


@contextmanager
def virtual_camera(device: str) -> Iterator[tuple[Any, Finding]]:
    """Find the virtual sensor that a device string means, or start one in this process.

    Args:
        device: `virtual`, or `virtual:PATH` for the sensor that listens there.

    Yields:
        A pyusb backend, None where the named one does not answer, and the finding.
    """
    from mixtac_driver.backend import open_backend
    from mixtac_sim.usb.errors import NoVirtualSensorError

    name = 'virtual sensor'
    try:
        backend = open_backend(device)
    except NoVirtualSensorError as error:
        if device != VIRTUAL:
            found, _, remedy = str(error).partition('; ')
            yield None, Finding(name, Level.ERROR, found, remedy)
            return
    else:
        yield backend, ok(name, 'one is running; it is the one that is looked at')
        return
    with _own_sensor() as own:
        yield own, ok(name, 'none is running; one was started for this test')


@contextmanager
def _own_sensor() -> Iterator[Any]:
    from mixtac_sim.usb.in_process import in_process_backend
    from mixtac_sim.virtual_sensor_factory import make_virtual_sensor

    sensor = make_virtual_sensor(device_seed=DEVICE_SEED, seed=SEED)
    sensor.start()
    try:
        yield in_process_backend(sensor.device)
    finally:
        sensor.close()

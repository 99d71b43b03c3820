# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual sensor in a process of its own, which `Sensor('virtual')` starts and ends.

`python -m mixtac.virtual SCENARIO` prints one line of JSON with the socket of its camera, and runs
until its standard input ends. A line of input is the stamp of a force; the answer is a line with
the simulated force at that time. If the host is too slow, simulated time pauses and no data are
lost.
"""

from __future__ import annotations

import json
import select
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cached_property, partial
from typing import Any, Final

from mixtac.latest import SensorError
from mixtac_core.events.errors import MixtacError
from mixtac_core.node.process import STOP_GRACE_S, ending_with_parent

NO_CONTACT: Final = 'idle'
LEAD_US: Final = 2_000_000
"""From the start of the stream to the first contact, and between two scenarios [us]."""
SCENARIO_S: Final = 25.0


class VirtualProcess:
    """Runs a virtual sensor until it is closed.

    Args:
        scenario: Force profile that is played again and again, one of
            `mixtac_sim.world.profiles.PROFILES`; empty for no contact.
    """

    def __init__(self, scenario: str) -> None:
        command = [sys.executable, '-m', 'mixtac.virtual', scenario or NO_CONTACT]
        self._process: Any = subprocess.Popen(
            ending_with_parent(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        print('starting a virtual sensor; a first start compiles for a minute', file=sys.stderr)

    @cached_property
    def device(self) -> str:
        """Device string of its camera; waits until the process is ready.

        Raises:
            SensorError: It does not start.
        """
        # Libraries may print lines before the answer.
        lines = self._process.stdout
        answer = next((line for line in lines if line.startswith(b'{')), b'{}')
        found = json.loads(answer)
        if not found.get('device'):
            self.close()
            why = found.get('error') or 'the virtual sensor ended before it was ready'
            raise SensorError(str(why), remedy='see what it printed')
        return str(found['device'])

    def true_force(self, stamp_us: int) -> float:
        """Return the simulated normal force [N], NaN if the process has ended.

        Args:
            stamp_us: Stamp of a reading of the last seconds [us].
        """
        with suppress(BrokenPipeError):
            self._process.stdin.write(b'%d\n' % stamp_us)
        return float(self._process.stdout.readline() or 'nan')

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(STOP_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._process.communicate()


def serve(scenario: str) -> None:
    """Serve a virtual camera until standard input ends.

    Args:
        scenario: See `VirtualProcess`.

    Raises:
        MixtacError: Unknown scenario, or the socket cannot be made.
    """
    from mixtac_sim.live.virtual_sensor import SimulationProcess, make_virtual_sensor
    from mixtac_sim.usb.server import UsbServer
    from mixtac_sim.world.effects import PAPER_LIKE
    from mixtac_sim.world.profiles import make_profile

    # Forked while this process has one thread.
    process = SimulationProcess()
    profile = partial(make_profile, scenario, duration_s=SCENARIO_S, preset=PAPER_LIKE, sync=False)
    profile(0)
    with tempfile.TemporaryDirectory(prefix='mixtac-') as folder:
        sensor = make_virtual_sensor(
            device_seed=1, seed=1, skew_ppm=17.0, preset=PAPER_LIKE, process=process
        )
        server = UsbServer(sensor.device, f'{folder}/camera.sock')
        try:
            sensor.start()
            print(json.dumps({'device': f'virtual:{server.path}'}), flush=True)
            plays = 0
            while True:
                if select.select([sys.stdin], [], [], 0.05)[0]:
                    if not (line := sys.stdin.readline()):
                        break
                    print(sensor.true_force(int(line)), flush=True)
                state = sensor.state()
                if state.streaming and not state.playing and scenario != NO_CONTACT:
                    sensor.play(profile(plays), lead_us=LEAD_US)
                    plays += 1
        finally:
            sensor.close()
            server.close()


def leave(*_: object) -> None:
    """Exit. Later signals are ignored: the other process sends one, and so may a whole group."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(0)


def main() -> int:
    """Run the virtual sensor."""
    # Ctrl-C comes to both processes; the other one decides when this one ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, leave)
    try:
        serve(sys.argv[1])
    except (MixtacError, ImportError) as error:
        # The other process sends one as soon as it has read this.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        print(json.dumps({'device': '', 'error': str(error)}), flush=True)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())

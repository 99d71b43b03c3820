# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels of a start, so that the first one is as fast as any; see `tools/setup.py`.

With `--tests` those of most tests as well, so that no two processes of tests compile the same. They
are kept on disk. Kernels that are not named here are compiled by the first process that runs them.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import sys
import tempfile
from pathlib import Path

from mixtac_core.events import codec
from mixtac_core.events.frames import PICTURE_KERNELS
from mixtac_core.node.process import compiling
from mixtac_driver import pixels
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_fger.estimator import open_estimator
from mixtac_fger.streaming import warm_up
from mixtac_fger.weights import find_model, read_model


def main() -> None:
    """Run each kernel once, in two processes beside each other."""
    with compiling('the packet codec'):
        codec.warm_up()
    parts = [sense]
    # A robot's environment lacks what the simulator needs.
    if all(importlib.util.find_spec(name) for name in ('mixtac_sim', 'joblib')):
        parts.append(simulate)
    spawning = multiprocessing.get_context('spawn')
    processes = [spawning.Process(target=part) for part in parts]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    if any(process.exitcode for process in processes):
        sys.exit('a kernel could not be compiled')
    if '--tests' in sys.argv[1:]:
        of_tests()


def sense() -> None:
    """Run decoder and estimator."""
    with compiling('the pixel mask'):
        pixels.warm_up()
    StreamDecoder(Geometry())
    with compiling(PICTURE_KERNELS):
        warm_up(open_estimator(read_model(find_model('fger_small'))))


def simulate() -> None:
    """Run the simulator."""
    from mixtac_core.recordings.dataset import TrialSpec
    from mixtac_sim.bags.trial_bag import write_trial

    with tempfile.TemporaryDirectory() as folder:
        for profile, preset in (('impact', 'easy'), ('press', 'hard')):
            spec = TrialSpec(profile, profile, 2.6, 1, 1, preset, 'train')
            write_trial(spec, Path(folder))


def of_tests() -> None:
    """Run what a start does without."""
    from mixtac_slip_control.arm.model import make_arm
    from mixtac_slip_control.features import SlipFeatures
    from mixtac_slip_control.parameters import SlipControlParameters

    SlipFeatures(SlipControlParameters()).warm_up()
    make_arm(SlipControlParameters(arm='fr3'))


if __name__ == '__main__':
    main()

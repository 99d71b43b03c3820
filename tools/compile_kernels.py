# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels that most tests need, so that no two processes of tests compile the same.

They are kept on disk. Kernels that are not named here are compiled by the first test that runs
them.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from mixtac_driver import pixels
from mixtac_events import codec
from mixtac_fger.estimator import open_estimator
from mixtac_fger.streaming import warm_up
from mixtac_fger.weights import find_model, read_model
from mixtac_lab.bench.decode import measure
from mixtac_recordings.dataset import TrialSpec
from mixtac_sim.bags.trial_bag import write_trial
from mixtac_slip_control.arm.model import make_arm
from mixtac_slip_control.features import SlipFeatures
from mixtac_slip_control.parameters import SlipControlParameters


def main() -> None:
    """Run each kernel once."""
    codec.warm_up()
    pixels.warm_up()
    with tempfile.TemporaryDirectory() as folder:
        for profile, preset in (('impact', 'easy'), ('press', 'hard')):
            spec = TrialSpec(profile, profile, 2.6, 1, 1, preset, 'train')
            write_trial(spec, Path(folder))
    warm_up(open_estimator(read_model(find_model('fger_small'))))
    measure(0.0, 100_000)
    SlipFeatures(SlipControlParameters()).warm_up()
    make_arm(SlipControlParameters(arm='fr3'))


if __name__ == '__main__':
    main()

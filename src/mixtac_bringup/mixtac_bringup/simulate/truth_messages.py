# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the virtual sensor would publish of a trial: truth, and the reference sensor's readings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_bringup.simulate.bag_topics import TRUTH_CLOCK, TRUTH_CONTACT, TRUTH_WRENCH
from mixtac_bringup.topics import REFERENCE

if TYPE_CHECKING:
    from mixtac_bringup.simulate.message_factory import MessageFactory
    from mixtac_bringup.simulate.message_sink import MessageSink
    from mixtac_bringup.simulate.trial_clocks import TrialClocks
    from mixtac_sim.datasets.trial_stream import Stretch, TrialStream

BATCH_NS: Final = 4_000_000
"""The virtual sensor publishes every 4 ms."""


class TruthMessages:
    """Makes the messages of truth and reference of a trial.

    Args:
        trial: The trial.
        clocks: Its clocks.
        factory: Makes the messages.
        sink: Takes them.
    """

    def __init__(
        self,
        trial: TrialStream,
        clocks: TrialClocks,
        factory: MessageFactory,
        sink: MessageSink,
    ) -> None:
        self._trial, self._clocks = trial, clocks
        self._factory, self._sink = factory, sink

    def begin(self) -> None:
        """Make what is said once."""
        truth = self._clocks.truth(self._trial.reference)
        epoch_ns = self._clocks.epoch_ns
        self._sink.put(epoch_ns, TRUTH_CLOCK, self._factory.clock_fit(truth, epoch_ns))

    def add(self, stretch: Stretch) -> None:
        """Make the messages of the next stretch."""
        received_ns = int(self._clocks.to_host_ns(np.array(stretch.end_us, np.int64)))
        self._add_truth(stretch)
        self._add_reference(stretch, received_ns)

    def _add_truth(self, stretch: Stretch) -> None:
        truth = stretch.sensor.truth
        stamps_ns = self._clocks.to_host_ns(truth['t_us'].astype(np.int64))
        received = (-(-stamps_ns // BATCH_NS) * BATCH_NS).tolist()
        wrench, point = np.zeros((len(truth), 6)), np.zeros((len(truth), 3))
        for column, name in enumerate(('fx', 'fy', 'fz')):
            wrench[:, column] = truth[name]
        point[:, 0], point[:, 1] = (1e-3 * place for place in self._trial.contact_mm)
        point[:, 2] = 1e-3 * truth['depth_mm']
        factory, put = self._factory, self._sink.put_rows
        put(received, TRUTH_WRENCH, factory.true_wrenches.make(stamps_ns, wrench))
        put(received, TRUTH_CONTACT, factory.contact_points.make(stamps_ns, point))

    def _add_reference(self, stretch: Stretch, latest_ns: int) -> None:
        samples, sensor = stretch.reference, self._trial.reference
        true_ns = (samples.t_ns - 1e9 * sensor.offset_s) / (1.0 + 1e-6 * sensor.drift_ppm)
        taken_ns = self._clocks.epoch_ns + true_ns.astype(np.int64)
        received = np.minimum(-(-taken_ns // BATCH_NS) * BATCH_NS, latest_ns).tolist()
        stamps_ns = self._clocks.reference_stamps_ns(samples.t_ns)
        data = self._factory.reference_wrenches.make(stamps_ns, samples.wrench)
        self._sink.put_rows(received, REFERENCE, data)

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the alignment node, the settings of every fit, and of the force error node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_core.node import topics
from mixtac_core.node.parameters import fixed, parameter


@dataclass(frozen=True)
class AlignmentParameters:
    """Definition of an impulse, limits of clocks and latencies, and length of the history.

    Attributes:
        reference_topic: WrenchStamped topic of the reference force sensor; its stamps are the
            reference clock.
        reference_axis: Axis of the wrench along which taps press; the sign does not matter.
        history: Length of the history; both taps must lie within it when ~/fit is called.
        reference_rate: Highest rate of the reference sensor; sizes its history.
        min_force: Smallest force peak of a tap. Lower finds gentler taps, and more false ones.
        max_width: Longest force peak or event trough of a tap, measured at half its height. Presses
            are longer.
        min_burst_rate: Smallest rise of the event rate of both bursts of a tap over the trough
            between them.
        min_baseline: Shortest time between the first and the last tap. The drift is known to about
            1 ms over this time.
        max_drift: Largest believable clock drift; crystals stay within 100.
        tap_latency: Delay of the events of a tap after the force: latency of the pixels. Less light
            needs more.
        tap_latency_std: Standard deviation of tap_latency; part of the stated uncertainty.
        drift_std: Prior standard deviation of the clock drift: two crystals of 30 to 40 ppm each.
            Pulls an uncertain drift towards 0; 0 disables the prior.
        use_frames: Weigh the events of a tap by the frames, which show the deformation.
        use_edges: Fit edges of a trigger line instead of taps: external_edges of the driver against
            reference_edges.
        use_all: Fit all strong taps by least squares, not only the first and the last.
    """

    reference_topic: str = fixed(topics.REFERENCE)
    reference_axis: str = parameter('z', choices=('x', 'y', 'z'))
    history: float = fixed(120.0, unit='s', within=(5.0, 3600.0))
    reference_rate: float = fixed(2000.0, unit='Hz', within=(10.0, 10000.0))
    min_force: float = parameter(0.2, unit='N', within=(0.01, 100.0))
    max_width: float = parameter(0.06, unit='s', within=(0.005, 0.5))
    min_burst_rate: float = parameter(5e4, unit='1/s', within=(1e3, 1e7))
    min_baseline: float = parameter(2.0, unit='s', within=(0.5, 3600.0))
    max_drift: float = parameter(200.0, unit='ppm', within=(1.0, 10000.0))
    tap_latency: float = parameter(1.3, unit='ms', within=(0.0, 50.0))
    tap_latency_std: float = parameter(1.0, unit='ms', within=(0.0, 50.0))
    drift_std: float = parameter(50.0, unit='ppm', within=(0.0, 10000.0))
    use_frames: bool = parameter(True)
    use_edges: bool = parameter(False)
    use_all: bool = parameter(False)


DEFAULTS = AlignmentParameters()


@dataclass(frozen=True)
class ForceErrorParameters:
    """Topics and length of the running force error.

    Attributes:
        force_topic: WrenchStamped topic of the estimate.
        reference_topic: WrenchStamped topic of the reference on the camera clock.
        window: Number of latest pairs over which the errors are averaged; 5000 are 10 s of
            estimates.
        sign: Sign that makes pressing positive in the reference.
    """

    force_topic: str = fixed('force')
    reference_topic: str = fixed('reference/wrench')
    window: int = fixed(5000, within=(10, 50_000))
    sign: int = fixed(1, within=(-1, 1))

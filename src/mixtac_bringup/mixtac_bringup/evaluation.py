# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How good a recorded run was: rates, losses, latency, and error against the aligned reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_alignment.impulses import ImpulseSettings
from mixtac_alignment.two_impulse import fit_two_impulses
from mixtac_events.codec import decode
from mixtac_events.windows import counts_per_window

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_bringup.bag_reader import BagFile

WINDOW_NS = 2_000_000
EDGE_US = 50_000
"""Half a synchronising impulse: what is compared begins and ends with whole impulses."""

IMPULSES = ImpulseSettings(max_force_gap_s=2.0)
"""A busy computer may lose reference samples, and its clock is known to be one here."""


@dataclass(frozen=True)
class Streams:
    """The streams of a recorded run.

    Attributes:
        event_t_us: Event times, camera clock [us], int64.
        lost_packets: Event packets missing by their sequence numbers.
        packets: Event packets recorded.
        force_ns: Ends of the force windows, camera clock [ns], int64.
        force_n: Estimated normal force [N].
        reference_ns: Stamps of the reference, reference clock [ns], int64.
        reference_n: Reference normal force [N].
    """

    event_t_us: NDArray[np.int64]
    lost_packets: int
    packets: int
    force_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    reference_ns: NDArray[np.int64]
    reference_n: NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """Estimate against reference, on the camera clock.

    Attributes:
        fit: The clock fit that brought the reference to the camera clock.
        start_us: Camera clock at time 0 below [us].
        time_s: Sample times [s].
        estimate_n: Estimated force [N].
        reference_n: Reference force at the same times [N].
        mae_n: Mean absolute error [N].
        rmse_n: Root mean square error [N].
        constant_mae_n: Error of the best constant guess (the median), for comparison [N].
    """

    fit: ClockFit
    start_us: int
    time_s: NDArray[np.float64]
    estimate_n: NDArray[np.float64]
    reference_n: NDArray[np.float64]
    mae_n: float
    rmse_n: float
    constant_mae_n: float


def read_streams(bag: BagFile, namespace: str, reference_topic: str) -> Streams:
    """Read the streams of one sensor from a bag.

    Raises:
        BagError: A topic is missing or the bag is damaged.
    """
    times, packets, lost, last = [], 0, 0, None
    for _, message in bag.messages(f'/{namespace}/events'):
        packets += 1
        lost += 0 if last is None else int(message.seq) - last - 1
        last = int(message.seq)
        decoded = decode(message.events, message.encoding, int(message.time_base))
        times.append(decoded.events.t)
    force_ns, force_n = bag.wrenches(f'/{namespace}/force')
    reference_ns, reference_n = bag.wrenches(reference_topic)
    event_t_us = np.concatenate(times) if times else np.empty(0, np.int64)
    return Streams(event_t_us, lost, packets, force_ns, force_n, reference_ns, reference_n)


def compare(streams: Streams) -> Comparison:
    """Bring the reference to the camera clock by the two impulses and compare.

    Samples from the first to the last impulse count, the impulses included.

    Raises:
        AlignmentError: The impulses were not found; the text says why.
    """
    fit = fit_two_impulses(
        streams.event_t_us, streams.reference_ns / 1e9, streams.reference_n, IMPULSES
    )
    reference_us = fit.to_camera(streams.reference_ns / 1e9)
    force_us = streams.force_ns // 1000
    first_us, last_us = fit.anchors[0].camera_us - EDGE_US, fit.anchors[-1].camera_us + EDGE_US
    inside = (force_us >= first_us) & (force_us <= last_us)
    estimate = streams.force_n[inside]
    reference = np.interp(force_us[inside], reference_us, streams.reference_n)
    error = np.abs(estimate - reference)
    return Comparison(
        fit=fit,
        start_us=first_us,
        time_s=(force_us[inside] - first_us) / 1e6,
        estimate_n=estimate,
        reference_n=reference,
        mae_n=float(error.mean()),
        rmse_n=float(np.sqrt((error**2).mean())),
        constant_mae_n=float(np.abs(reference - np.median(reference)).mean()),
    )


def lost_windows(stamps_ns: NDArray[np.int64]) -> int:
    """Return how many 2 ms windows are missing between the first and the last stamp."""
    if len(stamps_ns) == 0:
        return 0
    return int((stamps_ns[-1] - stamps_ns[0]) // WINDOW_NS) + 1 - len(stamps_ns)


def rate_hz(arrival_ns: NDArray[np.int64]) -> float:
    """Return the mean rate of arrivals [Hz], 0 with fewer than two."""
    if len(arrival_ns) < 2:
        return 0.0
    return float((len(arrival_ns) - 1) * 1e9 / (arrival_ns[-1] - arrival_ns[0]))


def latency_ms(
    arrival_ns: NDArray[np.int64], stamp_ns: NDArray[np.int64], clock_pairs: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the time from each window's end to its force at the subscriber [ms].

    Args:
        arrival_ns: Arrival of each force sample, host clock.
        stamp_ns: End of its window, camera clock.
        clock_pairs: (host, camera) pairs from `camera_clock`, shape (N, 2); interpolated.
    """
    host_minus_camera = (clock_pairs[:, 0] - clock_pairs[:, 1]).astype(np.float64)
    offset = np.interp(stamp_ns, clock_pairs[:, 1], host_minus_camera)
    return np.asarray((arrival_ns - stamp_ns - offset) / 1e6, np.float64)


def event_rate(
    streams: Streams, comparison: Comparison, width_us: int = 10_000
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return window centres [s, as in the comparison] and event rates [1/s]."""
    end_us = comparison.start_us + int(comparison.time_s[-1] * 1e6)
    counts = counts_per_window(streams.event_t_us, comparison.start_us, end_us, width_us)
    centres = (np.arange(len(counts)) + 0.5) * width_us / 1e6
    return np.asarray(centres, np.float64), np.asarray(counts * (1e6 / width_us), np.float64)

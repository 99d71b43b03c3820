# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a recorded run against its aligned reference: rates, losses, latency, error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.clock_fit import ClockFit
from mixtac_events.codec import decode_message
from mixtac_events.sequence import SequenceCounter
from mixtac_events.windows import counts_per_window
from mixtac_node import topics
from mixtac_node.stamps import stamp_to_ns
from mixtac_recordings.bag import BagFile
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import Segment

WINDOW_NS = 2_000_000
RATE_WINDOW_US = 10_000
EDGE_US = 50_000
"""Half a synchronising impulse: the comparison starts and ends with whole impulses."""
REST_US = (100_000, 500_000)
"""Rest without a load after the first impulse, and as long before the last one [us]."""


@dataclass(frozen=True)
class Streams:
    """The streams of a recorded run.

    Attributes:
        event_t_us: Event times, camera clock [us], int64.
        lost_packets: Event packets missing by their sequence numbers.
        complete_us: Time up to which each event packet is complete, camera clock [us], int64.
        arrival_ns: Arrival of each event packet at the host [ns], int64.
        force_ns: Ends of the force windows, camera clock [ns], int64.
        force_n: Estimated force, x, y and normal, shape (N, 3) [N].
        sideways_ns: Those of the windows whose force along x and y is known, int64.
        frame_ages: (end of the window [ns, camera clock], age of the latest frame [ns]) of each
            force, shape (N, 2), int64.
        invalid: Forces that are marked as not valid.
        reference_ns: Stamps of the reference, reference clock [ns], int64.
        reference_n: Reference normal force [N].
        truth_ns: Stamps of the simulated force, host clock [ns], int64.
        truth_n: Simulated force, x, y and normal, shape (N, 3) [N].
    """

    event_t_us: NDArray[np.int64]
    lost_packets: int
    complete_us: NDArray[np.int64]
    arrival_ns: NDArray[np.int64]
    force_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    sideways_ns: NDArray[np.int64]
    frame_ages: NDArray[np.int64]
    invalid: int
    reference_ns: NDArray[np.int64]
    reference_n: NDArray[np.float64]
    truth_ns: NDArray[np.int64]
    truth_n: NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """Estimate against reference, on the camera clock.

    Attributes:
        fit: The clock fit that brought the reference to the camera clock.
        start_us: Camera clock at time 0 below [us].
        time_s: Sample times [s].
        estimate_n: Estimated force [N].
        reference_n: Reference force at the same times, less its zero [N].
        sample_s: Times of the samples of the reference [s].
        sample_n: Samples of the reference, less its zero [N].
        zeros_n: Zero of the reference after the first and before the last impulse [N].
        rmse_n: Root mean square error [N].
        constant_mae_n: Error of the best constant guess (the median), for comparison [N].
    """

    fit: ClockFit
    start_us: int
    time_s: NDArray[np.float64]
    estimate_n: NDArray[np.float64]
    reference_n: NDArray[np.float64]
    sample_s: NDArray[np.float64]
    sample_n: NDArray[np.float64]
    zeros_n: tuple[float, float]
    rmse_n: float
    constant_mae_n: float


def read_streams(path: Path, namespace: str) -> Streams:
    """Read the streams of a virtual sensor from a bag.

    Raises:
        RecordingError: A topic is missing or the bag is damaged.
    """
    times: list[NDArray[np.int64]] = []
    complete_us, arrival_ns, ages, known_ns = [], [], [], []
    events, quality = (each.resolved(namespace) for each in (topics.EVENTS, topics.FORCE_QUALITY))
    counter, invalid = SequenceCounter(), 0
    with BagFile(path) as bag:
        for topic, _, message in bag.messages(events, quality):
            stamp_ns = stamp_to_ns(message.header.stamp)
            if topic == quality:
                ages.append((stamp_ns, round(1e9 * message.frame_age)))
                invalid += not message.valid
                if message.sideways_known:
                    known_ns.append(stamp_ns)
                continue
            counter.update(message.seq)
            packet = decode_message(message)
            times.append(packet.events.t)
            complete_us.append(packet.complete_until)
            arrival_ns.append(stamp_ns)
        force = bag.wrenches(topics.FORCE.resolved(namespace))
        reference_ns, reference = bag.wrenches(topics.REFERENCE)
        truth = bag.wrenches(topics.TRUTH_WRENCH.resolved(namespace))
    event_t_us = np.concatenate(times) if times else np.empty(0, np.int64)
    return Streams(
        event_t_us,
        counter.lost,
        np.array(complete_us, np.int64),
        np.array(arrival_ns, np.int64),
        *force,
        np.array(known_ns, np.int64),
        np.array(ages, np.int64).reshape(-1, 2),
        invalid,
        reference_ns,
        reference[:, 2],
        *truth,
    )


def compare(streams: Streams, fit: ClockFit) -> Comparison:
    """Bring the reference to the camera clock and compare.

    Samples from the first to the last impulse of the fit count, the impulses included. The zero of
    a reference sensor drifts. As on a bench it is taken without a load, before and after; between
    the two it follows a straight line.
    """
    reference_us = fit.to_camera(streams.reference_ns / 1e9)
    force_us = streams.force_ns // 1000
    first_us, last_us = fit.anchors[0].camera_us - EDGE_US, fit.anchors[-1].camera_us + EDGE_US
    inside = (force_us >= first_us) & (force_us <= last_us)
    estimate = streams.force_n[inside, 2]
    samples, zeros = _less_zero(
        reference_us, streams.reference_n, fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    )
    reference = np.interp(force_us[inside], reference_us, samples)
    error = estimate - reference
    return Comparison(
        fit=fit,
        start_us=first_us,
        time_s=(force_us[inside] - first_us) / 1e6,
        estimate_n=estimate,
        reference_n=reference,
        sample_s=(reference_us - first_us) / 1e6,
        sample_n=samples,
        zeros_n=zeros,
        rmse_n=float(np.sqrt((error**2).mean())),
        constant_mae_n=float(np.abs(reference - np.median(reference)).mean()),
    )


def _less_zero(
    t_us: NDArray[np.int64], reference_n: NDArray[np.float64], first_us: int, last_us: int
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    near, far = REST_US
    rests = (first_us + near, first_us + far), (last_us - far, last_us - near)
    before, after = (
        float(np.mean(reference_n[(t_us >= start) & (t_us <= end)])) for start, end in rests
    )
    middles = [0.5 * (start + end) for start, end in rests]
    return reference_n - np.interp(t_us, middles, (before, after)), (before, after)


def lost_windows(stamps_ns: NDArray[np.int64]) -> int:
    """Return how many 2 ms windows are missing between the first and the last stamp."""
    if len(stamps_ns) == 0:
        return 0
    return int((stamps_ns[-1] - stamps_ns[0]) // WINDOW_NS) + 1 - len(stamps_ns)


def mean_rate_hz(arrival_ns: NDArray[np.int64]) -> float:
    """Return the mean rate of arrivals [Hz], 0 with fewer than two."""
    if len(arrival_ns) < 2:
        return 0.0
    return float((len(arrival_ns) - 1) * 1e9 / (arrival_ns[-1] - arrival_ns[0]))


def host_time(
    streams: Streams, camera_ns: NDArray[np.int64], clock_pairs: NDArray[np.int64] | None
) -> NDArray[np.int64]:
    """Return the host time of times of the camera clock [ns].

    Args:
        streams: The streams of the run.
        camera_ns: Camera clock [ns].
        clock_pairs: (host, camera) pairs from `camera_clock`, shape (N, 2); interpolated. None if
            simulated time stopped now and then, which they do not follow: then the arrival of the
            packet up to that time is taken, which is later by the way through camera and driver.
    """
    if clock_pairs is None:
        packet = np.searchsorted(streams.complete_us * 1000, camera_ns)
        return np.asarray(
            streams.arrival_ns[packet.clip(max=len(streams.arrival_ns) - 1)], np.int64
        )
    host_minus_camera = (clock_pairs[:, 0] - clock_pairs[:, 1]).astype(np.float64)
    offset = np.interp(camera_ns, clock_pairs[:, 1], host_minus_camera)
    return camera_ns + offset.astype(np.int64)


def truth_mae(streams: Streams, clock_pairs: NDArray[np.int64] | None) -> float:
    """Return the mean absolute error of the estimate against the simulated force [N].

    Args:
        streams: The streams of the run.
        clock_pairs: As of `host_time`; forces before the first are left out.
    """
    host_ns = host_time(streams, streams.force_ns, clock_pairs)
    inside = (host_ns >= streams.truth_ns[0]) & (host_ns <= streams.truth_ns[-1])
    if clock_pairs is not None:
        inside &= streams.force_ns >= clock_pairs[0, 1]
    truth = np.interp(host_ns[inside], streams.truth_ns, streams.truth_n[:, 2])
    return float(np.abs(streams.force_n[inside, 2] - truth).mean())


def mae(comparison: Comparison, factor: float = 1.0) -> float:
    """Return the mean absolute error of the estimate times a factor [N]."""
    return float(np.abs(factor * comparison.estimate_n - comparison.reference_n).mean())


def peak_error(comparison: Comparison, spans: list[tuple[str, float, float]]) -> float | None:
    """Return the relative error of the highest force of the impact; None without an impact.

    The reference counts with all its samples: an impact lasts only a few windows, and at their ends
    its peak is cut off.

    Args:
        comparison: Estimate and reference.
        spans: From `phases`.
    """
    for name, start_s, end_s in spans:
        if name != _IMPACT:
            continue
        estimate = _between(comparison.time_s, comparison.estimate_n, start_s, end_s)
        reference = _between(comparison.sample_s, comparison.sample_n, start_s, end_s)
        if len(estimate) and len(reference):
            return float(estimate.max() / reference.max() - 1.0)
    return None


def _between(
    time_s: NDArray[np.float64], values: NDArray[np.float64], start_s: float, end_s: float
) -> NDArray[np.float64]:
    return values[(time_s >= start_s) & (time_s <= end_s)]


def event_rate(
    streams: Streams, comparison: Comparison | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return window centres [s, as in the comparison] and event rates [1/s].

    Without a comparison the times count from the first force.
    """
    if comparison is None:
        start_us, end_us = int(streams.force_ns[0]) // 1000, int(streams.force_ns[-1]) // 1000
    else:
        start_us = comparison.start_us
        end_us = start_us + int(comparison.time_s[-1] * 1e6)
    counts = counts_per_window(streams.event_t_us, start_us, end_us, RATE_WINDOW_US)
    centres = (np.arange(len(counts)) + 0.5) * RATE_WINDOW_US / 1e6
    return np.asarray(centres, np.float64), np.asarray(counts * (1e6 / RATE_WINDOW_US), np.float64)


_PRESS, _OSCILLATION, _IMPACT = 'press and hold', 'oscillation', 'impact of a dropped weight'
_TREMOR_N = 0.05
_MARGIN_S = 0.1
_WAVES_S = 2.0
_BOUNCES_S = 0.8


def phases(seconds: float, seed: int) -> list[tuple[str, float, float]]:
    """Return name, start and end [s, as in the comparison] of the enlarged part of each phase.

    The comparison starts at the first synchronising impulse, whose time the profile knows.

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    profile = make_profile('demo', seed, seconds, sync=True)
    origin = profile.sync_s[0] - EDGE_US / 1e6
    inner = [s for s in profile.segments if profile.sync_s[0] < s.start_s]
    inner = [s for s in inner if s.end_s < profile.sync_s[-1]]
    spans: dict[str, tuple[float, float]] = {}
    for segment in inner:
        name = _name(segment)
        start = spans.get(name, (segment.start_s - origin, 0.0))[0]
        spans[name] = (start, segment.end_s - origin)
    return [(name, *_shown(name, *span)) for name, span in spans.items()]


def _name(segment: Segment) -> str:
    if segment.mode >= Mode.DROP:
        return _IMPACT
    return _OSCILLATION if segment.tones and segment.tones[0].amplitude > _TREMOR_N else _PRESS


def _shown(name: str, start: float, end: float) -> tuple[float, float]:
    if name == _OSCILLATION:
        middle = (start + end) / 2
        return max(start, middle - _WAVES_S / 2), min(end, middle + _WAVES_S / 2)
    if name == _IMPACT:
        return start, min(end, start + _BOUNCES_S)
    return start - _MARGIN_S, end + _MARGIN_S

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac calibrate-force` has found, and how it finds that in a recording.

Of a recording, the plateaus are taken in their order; a live sensor is for
`mixtac_cli.calibrate_force.live`. What a plateau is, and what is refused, is in
`mixtac_fger.force_calibration`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.force_calibration import (
    CONTACT_N,
    ForceCalibrationError,
    Load,
    Plateau,
    Stretch,
    find_plateaus,
    reference_loads,
    steady_stretches,
)
from mixtac_fger.pull_calibration import KnownPull, find_pulls, last_contact, measured
from mixtac_fger.weights import Model
from mixtac_recordings.recording import Recording

F64 = NDArray[np.float64]
Sideways = tuple[Load, str]
"""A pull and its direction, of `WAYS`."""


@dataclass
class Session:
    """What a calibration has found so far.

    Attributes:
        t_s: Times of the force series [s].
        force_n: Estimates before the calibration [N].
        plateaus: Plateau of each load.
        loads: Known loads.
        zeros: Steady stretches without a load.
        pulls: Known pulls to the side, and what the estimate made of them.
        serial: Serial number of the camera, empty while unknown.
        known_by: `weights`, `scale` or `reference`.
        stopped_early: Further loads would not have told anything.
    """

    t_s: F64 = field(default_factory=lambda: np.zeros(0))
    force_n: F64 = field(default_factory=lambda: np.zeros(0))
    plateaus: list[Plateau] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    zeros: list[Stretch] = field(default_factory=list)
    pulls: list[KnownPull] = field(default_factory=list)
    serial: str = ''
    known_by: str = 'weights'
    stopped_early: bool = False


def from_bag(
    path: Path,
    model: Model,
    loads: Sequence[Load],
    reference: str,
    pulls: Sequence[Sideways] = (),
) -> Session:
    """Return the plateaus of a recording of the procedure.

    Args:
        path: Bag or AEDAT4 file that begins and ends without a load.
        model: Model that estimates its forces.
        loads: Loads in their order.
        reference: Topic of a reference force to take instead if the bag has it; empty for none.
        pulls: Loads to the side in their order, all in the last contact; empty for none.

    Raises:
        MixtacError: The recording cannot be read, or the sensor cannot be calibrated by it.
    """
    from mixtac_recordings.camera_stream import open_recording

    recording = open_recording(path)
    try:
        t_us, forces = estimated(recording, model)
    finally:
        recording.close()
    if not len(t_us):
        raise ForceCalibrationError(
            f'{path} gives no valid force: it begins in contact, has no frames, or its pictures'
            ' are not those of its begin',
            'contact',
            'record events and frames, and begin with a second without a load',
        )
    session = Session(1e-6 * (t_us - t_us[0]), forces[:, 0], loads=list(loads))
    by = None
    if path.is_dir() or path.suffix in {'.mcap', '.db3'}:
        by = _bag_facts(path, session, recording, int(t_us[0]), reference)
    t_s, force_n, last = session.t_s, session.force_n, len(t_us)
    if pulls:
        last, contact = last_contact(t_s, force_n)
        session.pulls, rests = find_pulls(t_s[contact], forces[contact, 1:], pulls)
        if by is not None:
            session.pulls = measured(by[0], by[1][:, 1:], session.pulls, rests)
    if by is None:
        session.plateaus = find_plateaus(t_s[:last], force_n[:last], loads)
    else:
        session.known_by = 'reference'
        session.plateaus = find_plateaus(t_s[:last], force_n[:last], ())
        free = steady_stretches(t_s, force_n)
        session.zeros = [each for each in free if abs(each.mean_n - free[0].mean_n) < CONTACT_N]
        session.loads = reference_loads(by[0], by[1][:, 0], session.plateaus, session.zeros)
    return session


def estimated(recording: Recording, model: Model) -> tuple[NDArray[np.int64], F64]:
    """Return window ends [us, recorded camera clock] and estimates of a recording.

    Estimates are the normal force, and that along x and y, NaN where it is unknown [N], [T, 3];
    those that are not valid are left out.
    """
    from mixtac_fger.estimator import open_estimator
    from mixtac_fger.streaming import ForceEstimator
    from mixtac_recordings.messages import left_aligned

    # A recording for a calibration begins without a load.
    estimator = ForceEstimator(open_estimator(model), assume_free=True)
    rows: list[tuple[float, ...]] = []
    for piece in recording.pieces(recording.info.start_us):
        for frame in piece.frames:
            image = left_aligned(np.minimum(frame.image, np.uint16(1023)))
            estimator.push_frame(image, frame.middle_us)
        if piece.advances:
            for each in estimator.push_events(piece.events, piece.until_us):
                x, y = (np.nan, np.nan) if each.shear is None else each.shear[:2]
                if each.valid:
                    rows.append((each.end_us, each.force, x, y))
    table = np.array(rows, np.float64).reshape(-1, 4)
    return table[:, 0].astype(np.int64), table[:, 1:]


def _bag_facts(
    path: Path, session: Session, recording: Recording, start_us: int, reference: str
) -> tuple[F64, F64] | None:
    """Note the camera's serial number; return times and forces of the reference if it is there.

    Forces are the normal one, x and y [N], [T, 3].
    """
    from mixtac_node.topics import CAMERA_CLOCK, normal_force, sideways_force
    from mixtac_recordings.bag import BagFile

    with BagFile(path) as bag:
        for topic in bag.topics(CAMERA_CLOCK.type_name):
            session.serial = next(bag.messages(topic))[2].source
        if not reference or not bag.counts.get(reference):
            return None
        _, leader = recording.info.contents[0]
        _, received_ns, _ = next(bag.messages(leader))
        # Plateaus last seconds: the first packet's delay and the clocks' drift do not matter.
        begin_ns = received_ns + 1000 * (start_us - recording.info.start_us)
        rows = [
            (ns - begin_ns, normal_force(m), *sideways_force(m))
            for _, ns, m in bag.messages(reference)
        ]
    table = np.array(rows, np.float64)
    return 1e-9 * table[:, 0], table[:, 1:]

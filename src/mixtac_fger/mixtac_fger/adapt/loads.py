# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Known loads: what a kitchen scale said, and when."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.dataset import ForceLabel
from mixtac_fger.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_NUMBER = r'(\d+(?:\.\d*)?|\.\d+)'
_FORM = re.compile(f'{_NUMBER}:{_NUMBER}-{_NUMBER}')
_US_PER_S = 1e6
MARGIN_S = 0.1
"""Left out at both ends of a load: a hand is not on time [s] (estimate)."""


@dataclass(frozen=True, slots=True)
class Load:
    """A constant force.

    Attributes:
        force: Normal force [N].
        start_s: From here on [s], since the recording began: its first
            event or exposure.
        end_s: Until here [s].
    """

    force: float
    start_s: float
    end_s: float


def parse_load(text: str) -> Load:
    """Return the load of a text like `0.5:3.0-6.0`: newtons, seconds.

    Raises:
        CalibrationError: The text has another form, or the times leave nothing.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise CalibrationError(f'load {text!r}: give newtons and seconds like 0.5:3.0-6.0')
    force, start_s, end_s = (float(part) for part in match.groups())
    if end_s - start_s <= 2.0 * MARGIN_S:
        raise CalibrationError(f'load {text!r}: give more than {2 * MARGIN_S:.1f} s')
    return Load(force, start_s, end_s)


def load_label(loads: Sequence[Load], start_us: int, end_us: int) -> ForceLabel:
    """Return a curve through the loads, zero elsewhere; `known_windows` tells where it holds.

    Args:
        loads: Loads.
        start_us: Beginning of the recording [us, camera clock].
        end_us: Its end [us].

    Raises:
        CalibrationError: Loads overlap, or lie outside the recording.
    """
    ordered = sorted(loads, key=lambda load: load.start_s)
    length_s = (end_us - start_us) / _US_PER_S
    times, forces = [float(start_us)], [0.0]
    before_s = 0.0
    for load in ordered:
        if load.start_s < before_s or load.end_s > length_s:
            raise CalibrationError(
                f'load of {load.force} N from {load.start_s} to {load.end_s} s overlaps another'
                f' one or lies outside the recording of {length_s:.1f} s: correct its times'
            )
        before_s = load.end_s
        start, end = (start_us + _US_PER_S * t for t in (load.start_s, load.end_s))
        times += [start, start + 1.0, end - 1.0, end]
        forces += [0.0, load.force, load.force, 0.0]
    times.append(max(float(end_us), times[-1] + 1.0))
    forces.append(0.0)
    return ForceLabel(np.array(times), np.array(forces))


def known_windows(
    loads: Sequence[Load], window_end_us: NDArray[np.int64], start_us: int
) -> NDArray[np.bool_]:
    """Return in which windows the force is known, bool [T].

    Args:
        loads: Loads.
        window_end_us: Ends of the windows [us, camera clock].
        start_us: Beginning of the recording [us].
    """
    since_s = (window_end_us - start_us) / _US_PER_S
    known = np.zeros(len(since_s), np.bool_)
    for load in loads:
        known |= (since_s > load.start_s + MARGIN_S) & (since_s < load.end_s - MARGIN_S)
    return known

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The acceptance test of a camera: the ten checks of `mixtac_driver.doctor.stretch`, in order.

One stream is looked at: a still stretch, one with other biases, one with a light that somebody
flashes. Then the camera is unplugged three times.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from mixtac_driver.camera import CameraBatch, Davis346
from mixtac_driver.doctor.stretch import (
    BIAS_CHANGES,
    CHECKS,
    Check,
    Stretch,
    check_biases,
    check_stamps,
    failed,
    judged,
    passive_checks,
    skipped,
)
from mixtac_driver.parameters import DriverParameters
from mixtac_events.errors import MixtacError

SETTLE_S = 0.5
UNPLUGGED = 3
UNPLUG_TIMEOUT_S = 60.0
MOST_RETURN_S = 5.0
GONE_S = 0.05


@dataclass(frozen=True)
class Person:
    """What somebody does at the camera, or the virtual camera does by itself.

    Attributes:
        flash: Announces that the light is to be flashed for some time [s]; None skips that check.
        unplug: Announces that the camera is to be unplugged and plugged in; None skips that.
        edges_hz: Frequency of the signal at the synchronisation connector [Hz]; 0 skips that.
    """

    flash: Callable[[float], None] | None = None
    unplug: Callable[[], None] | None = None
    edges_hz: float = 0.0


PATIENCE = 5.0
"""Times by which the host's clock may be ahead of the camera's, as a slow simulation's is."""


def take(batches: Iterator[CameraBatch], seconds: float, settle_s: float = 0.0) -> Stretch:
    """Return what a camera sends for some time [s], after another time to settle [s].

    It is the camera's time, or several times as long by the host if the camera's stands still.
    """
    stretch, began_us, late_s = Stretch(), None, time.monotonic() + PATIENCE * (settle_s + seconds)
    for batch in batches:
        now_us = batch.time_us
        began_us = now_us if began_us is None else began_us
        passed_s = 1e-6 * (now_us - began_us)
        if passed_s >= settle_s:
            stretch.add(batch)
        if passed_s >= settle_s + seconds or time.monotonic() >= late_s:
            break
    return stretch


def accept(
    parameters: DriverParameters,
    seconds: float,
    person: Person,
    *,
    backend: Any = None,  # noqa: ANN401
    wanted: tuple[int, ...] = tuple(range(1, len(CHECKS) + 1)),
    identify: Callable[[dict[str, str]], None] | None = None,
    settle_s: float = SETTLE_S,
) -> Iterator[Check]:
    """Make the checks; yield each result when it is there.

    Args:
        parameters: Device, serial number and settings of the camera.
        seconds: Length of the still stretch [s].
        person: Who does what cannot be done over USB.
        backend: A pyusb backend to use instead of the one that the device string names.
        wanted: Numbers of the checks to make.
        identify: Called with what the camera says of itself.
        settle_s: Time before the still stretch [s].
    """
    p = replace(
        parameters,
        external_input_enabled=True,
        external_input_rising=True,
        aps_auto_exposure=False,
    )
    camera = Davis346(p, backend=backend)
    done: set[int] = set()
    try:
        camera.open()
        if identify is not None:
            known = camera.identity
            firmware, logic = ('.'.join(map(str, v)) for v in (known.firmware, known.logic))
            names = {'serial': known.serial, 'chip': known.chip}
            identify({**names, 'firmware': firmware, 'logic': logic})
        camera.start()
        for check in _streaming_checks(camera, p, (settle_s, seconds), person, wanted):
            done.add(check.number)
            yield check
        camera.stop()
        if 5 in wanted:
            done.add(5)
            yield _check_unplugging(camera, person)
    except MixtacError as error:
        yield from (failed(number, error) for number in wanted if number not in done)
    finally:
        with contextlib.suppress(MixtacError):
            camera.close()


def _streaming_checks(
    camera: Davis346,
    p: DriverParameters,
    times_s: tuple[float, float],
    person: Person,
    wanted: tuple[int, ...],
) -> Iterator[Check]:
    batches = camera.batches()
    settle_s, seconds = times_s
    still = take(batches, seconds, settle_s=settle_s)
    for check in passive_checks(still, person.edges_hz):
        if check.number in wanted:
            yield check
    if 4 in wanted:
        changed, step_s = {}, max(seconds / 10, 0.3)
        for change in BIAS_CHANGES:
            camera.apply(replace(p, **dict(change.values)))
            # Leaking pixels that a lower threshold overtakes fire at once, and then not for long.
            changed[change.bias] = take(batches, step_s, settle_s=0.0 if change.rises else 0.2)
        camera.apply(p)
        yield check_biases(still, changed)
    if 7 in wanted:
        if person.flash is None:
            yield skipped(7, 'nobody flashes a light (--flash)')
        else:
            take(batches, 0.0, settle_s=0.3)
            flash_s = max(seconds / 2, 3.0)
            person.flash(flash_s)
            yield check_stamps(take(batches, flash_s))


def _check_unplugging(camera: Davis346, person: Person) -> Check:
    """Wait for the camera to go and come back three times; data must come again each time."""
    limit = f'{MOST_RETURN_S:g} s'
    if person.unplug is None:
        return skipped(5, 'nobody unplugs the camera (--unplug)')
    longest_s = 0.0
    for count in range(1, UNPLUGGED + 1):
        person.unplug()
        if not _until(lambda: not camera.attached()):
            found = f'the camera did not go away for the {count}. time'
            return judged(5, math.nan, good=False, limit=limit, found=found)
        camera.close()
        if not _until(lambda: bool(camera.attached())):
            found = f'the camera did not come back after the {count}. time'
            return judged(5, math.nan, good=False, limit=limit, found=found)
        back_s = time.monotonic()
        heard = False
        while not heard and time.monotonic() < back_s + MOST_RETURN_S:
            # The rules of udev take a moment to give permission.
            with contextlib.suppress(MixtacError):
                camera.open()
                camera.start()
                heard = next(iter(camera.batches()), None) is not None
            if not heard:
                camera.close()
                time.sleep(GONE_S)
        longest_s = max(longest_s, time.monotonic() - back_s)
        if not heard:
            found = f'no data after the {count}. time'
            return judged(5, longest_s, good=False, limit=limit, found=found)
    found = f'streams again at most {longest_s:.1f} s after it was plugged in, {UNPLUGGED} times'
    return judged(5, longest_s, longest_s <= MOST_RETURN_S, limit, found)


def _until(condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + UNPLUG_TIMEOUT_S
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(GONE_S)
    return True

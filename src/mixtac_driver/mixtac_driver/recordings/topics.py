# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which of the topics of a recording to play."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.errors import RecordingError
from mixtac_driver.recordings.playback_parameters import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence


def choose(
    found: Sequence[str], wanted: str, *, kind: str, path: object, beside: str = ''
) -> str | None:
    """Return the name of the topic to play, or None for none of them.

    Args:
        found: Topics that hold such data.
        wanted: The parameter: a name, empty or `none`.
        kind: What it holds, as in the name of the parameter: events, image or imu.
        path: The recording, for messages.
        beside: A topic; of several, one in its namespace is taken if it is the only one there.

    Raises:
        RecordingError: The wanted one is not there, or several are and none was named.
    """
    listed = ', '.join(found) or 'none'
    if wanted == NONE:
        return None
    if wanted and wanted not in found:
        raise RecordingError(
            f'{path} has no {kind} {wanted!r}; it has {listed}: change playback_{kind}_topic'
        )
    if wanted or not found:
        return wanted or None
    if len(found) == 1:
        return found[0]
    space = beside.rpartition('/')[0]
    near = [name for name in found if beside and name.rpartition('/')[0] == space]
    if len(near) == 1:
        return near[0]
    raise RecordingError(
        f'{path} has several {kind} topics: choose one of {listed} with playback_{kind}_topic'
    )

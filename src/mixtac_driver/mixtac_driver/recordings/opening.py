# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From a path to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_driver.errors import RecordingError
from mixtac_driver.recordings import aedat4, bag_file
from mixtac_driver.recordings.aedat4 import Aedat4Recording
from mixtac_driver.recordings.rosbag2 import BagRecording

if TYPE_CHECKING:
    from mixtac_driver.recordings.pieces import Recording
    from mixtac_driver.recordings.playback_parameters import PlaybackParameters

SUFFIXES = (aedat4.SUFFIX, *bag_file.SUFFIXES)


def looks_like_a_path(device: str) -> bool:
    """Return whether a device string can only be the path of a recording."""
    path = Path(device)
    return path.suffix in SUFFIXES or '/' in device or path.exists()


def open_recording(device: str, parameters: PlaybackParameters) -> Recording:
    """Open a recording.

    Args:
        device: Its path: an .aedat4, .mcap or .db3 file, or the folder of a bag.
        parameters: Which of its topics to play.

    Raises:
        RecordingError: There is none, it cannot be read, is empty, or leaves a choice of topics.
    """
    path = Path(device).expanduser()
    if not path.exists():
        raise RecordingError(
            f'no recording at {path}: give an .aedat4, .mcap or .db3 file or the folder of a bag'
        )
    if path.suffix == aedat4.SUFFIX:
        return Aedat4Recording(path, parameters)
    if path.is_dir() or path.suffix in bag_file.SUFFIXES:
        return BagRecording(path, parameters)
    raise RecordingError(
        f'{path} is no recording: give an .aedat4, .mcap or .db3 file or the folder of a bag'
    )

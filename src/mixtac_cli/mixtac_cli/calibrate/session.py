# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Collecting views of a calibration board, from live images or from a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_driver.calibration.board import (
    WANTED_COVERAGE,
    WANTED_SPREAD,
    Board,
    Verdict,
    View,
    ViewSelection,
    coverage,
    find_board,
    spread,
    stretched,
)
from mixtac_driver.calibration.lens import RefusedError
from mixtac_driver.calibration.solve import fit_lens
from mixtac_node.files import replacing
from mixtac_node.images import ImageConversionError, image_array
from mixtac_node.topics import IMAGE_RAW
from mixtac_recordings.bag import BagFile
from mixtac_recordings.recording import RecordingError

Grey = NDArray[np.uint8 | np.uint16]


def grey_image(message: Any) -> Grey:  # noqa: ANN401
    """Return the brightness of an image message, `uint8` or `uint16` [height, width].

    Args:
        message: A `sensor_msgs/Image` of rclpy or of rosbags.

    Raises:
        RecordingError: Unknown encoding, or fewer data than the size requires.
    """
    deep = '16' in str(message.encoding)
    try:
        return image_array(message, 'mono16' if deep else 'mono8')
    except ImageConversionError as error:
        raise RecordingError(str(error)) from error


def image_label(message: Any) -> str:  # noqa: ANN401
    """Return the stamp of a message [s] as the label of its view."""
    stamp = message.header.stamp
    return f'{stamp.sec}.{stamp.nanosec // 1_000_000:03d}'


def bag_images(path: Path, topic: str, rate_hz: float) -> Iterator[tuple[str, Grey]]:
    """Yield label and brightness of the images of a bag.

    Args:
        path: Folder of the bag.
        topic: Topic of the images.
        rate_hz: Most images per second of the recording [Hz]; 0 for all.

    Raises:
        RecordingError: No bag, no such topic, or no images on it.
    """
    period_ns = 1e9 / rate_hz if rate_hz > 0.0 else 0.0
    next_ns = 0.0
    with BagFile(path) as bag:
        kind = bag.types.get(topic)
        if kind not in (None, IMAGE_RAW.type_name):
            raise RecordingError(f'{path}: {topic} carries {kind}; name the topic of the images')
        for _, received_ns, message in bag.messages(topic):
            # Tolerate half a millisecond of jitter.
            if received_ns < next_ns - 500_000:
                continue
            next_ns = received_ns + period_ns
            yield image_label(message), grey_image(message)


FIT_FROM = 8
FIT_EVERY = 4
PICTURE_SCALE = 3
HINTS = (
    'move the board to the left and right edge',
    'move the board to the top and bottom edge',
    'hold the board nearer and further away',
    'tilt and turn the board',
    'move the board into the image corners',
)


class CalibrationSession:
    """Takes images one by one and keeps the views worth fitting, with their images.

    Args:
        board: The checkerboard.
        model: Lens model of the running fit.
        thorough: Search each image more thoroughly for small squares.

    Attributes:
        selection: The views kept.
        images: Their images, in the same order.
        seen: Images looked at.
        found: Images that show the whole board.
        rms_px: Reprojection error of the running fit [px], NaN before the first.
        last: Whether the view in the last image was kept; None without the whole board in it.
    """

    def __init__(self, board: Board, model: str, *, thorough: bool = False) -> None:
        self._board = board
        self._model = model
        self._thorough = thorough
        self.selection = ViewSelection()
        self.images: list[Grey] = []
        self.seen = 0
        self.found = 0
        self.rms_px = float('nan')
        self.last: Verdict | None = None

    def offer(self, image: Grey, label: str) -> None:
        """Look for the board in an image and keep the view if it shows something new."""
        self.seen += 1
        view = find_board(image, self._board, label, thorough=self._thorough)
        self.last = None
        if view is not None:
            self.found += 1
            self.last = self.selection.offer(view)
            if self.last is Verdict.KEPT:
                self.images.append(image)
                self._update_fit()

    def progress(self) -> list[tuple[str, float]]:
        """Return how far each requirement is met, 0 .. 1, by name."""
        views = self.selection.views
        shares = [
            min(1.0, got / wanted) for got, wanted in zip(spread(views), WANTED_SPREAD, strict=True)
        ]
        shares.append(min(1.0, coverage(views) / WANTED_COVERAGE))
        return list(zip(('x', 'y', 'size', 'skew', 'coverage'), shares, strict=True))

    def hint(self) -> str:
        """Return how to move the board next."""
        shares = [share for _, share in self.progress()]
        if min(shares) >= 1.0:
            return 'enough views' if self.selection.complete else 'a few more views'
        return HINTS[int(np.argmin(shares))]

    def save_pictures(self, folder: Path) -> None:
        """Write the kept images with their detected corners.

        Raises:
            FileError: A file cannot be written.
        """
        for index, (view, image) in enumerate(zip(self.selection.views, self.images, strict=True)):
            _save_picture(folder / f'view_{index:02d}.png', view, image)

    def _update_fit(self) -> None:
        views = self.selection.views
        if len(views) < FIT_FROM or len(views) % FIT_EVERY:
            return
        try:
            errors = fit_lens(views, self._model).view_rms_px
        except RefusedError:
            return
        self.rms_px = float(np.sqrt(np.mean(errors**2)))


def _save_picture(path: Path, view: View, image: Grey) -> None:
    grey = stretched(image)
    large = cv2.resize(
        grey if grey is not None else np.zeros(image.shape, np.uint8),
        None,
        fx=PICTURE_SCALE,
        fy=PICTURE_SCALE,
        interpolation=cv2.INTER_NEAREST,
    )
    colour = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    corners = ((view.corners + 0.5) * PICTURE_SCALE - 0.5).astype(np.float32).reshape(-1, 1, 2)
    cv2.drawChessboardCorners(colour, (view.board.columns, view.board.rows), corners, True)
    _, data = cv2.imencode('.png', colour)
    with replacing(path) as scratch:
        scratch.write_bytes(data.tobytes())

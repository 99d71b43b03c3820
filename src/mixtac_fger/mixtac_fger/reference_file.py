# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The no-contact reference of a sensor as a file, so that estimating may begin in contact."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import ReferenceFileError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_fger.config import FgerConfig

    F32 = NDArray[np.float32]

_REMEDY = 'delete it, or write a new one with ~/tare while the sensor is untouched'


def save_reference(path: Path, contrast: F32, config: FgerConfig) -> None:
    """Write a reference; an existing file is replaced only once the new one is complete.

    Args:
        path: File, `.npz` by custom.
        contrast: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
        config: Of the network that prepared it.

    Raises:
        ReferenceFileError: The file cannot be written.
    """
    partial = path.with_name(path.name + '.partial')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open('wb') as file:
            np.savez(file, contrast=contrast, preparation=_preparation(config))
        partial.replace(path)
    except OSError as error:
        raise ReferenceFileError(f'reference {path} cannot be written: {error}') from error


def load_reference(path: Path, config: FgerConfig) -> F32:
    """Return a reference that `save_reference` wrote.

    Args:
        path: File.
        config: Of the network that reads it.

    Raises:
        ReferenceFileError: The file is missing or damaged, or was prepared in another way.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            contrast, preparation = np.asarray(file['contrast']), np.asarray(file['preparation'])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ReferenceFileError(f'reference {path} cannot be read ({error}): {_REMEDY}') from error
    if not np.array_equal(preparation, _preparation(config)):
        raise ReferenceFileError(
            f'reference {path} was made for a model that prepares frames in another way: {_REMEDY}'
        )
    if contrast.shape != config.frame_shape or not np.isfinite(contrast).all():
        raise ReferenceFileError(f'reference {path} holds no picture of this model: {_REMEDY}')
    return np.ascontiguousarray(contrast, np.float32)


def _preparation(config: FgerConfig) -> NDArray[np.float64]:
    """Return what decides how a frame becomes a coarse contrast."""
    return np.array(
        [config.height, config.width, config.frame_bin, config.gradient_bin, config.log_floor]
    )

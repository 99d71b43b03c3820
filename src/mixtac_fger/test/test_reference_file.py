# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stored no-contact references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_fger.config import FgerConfig
from mixtac_fger.frames import ReferenceFileError, load_reference, save_reference


@pytest.fixture
def contrast() -> np.ndarray:
    shape = FgerConfig().frame_shape
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)


def test_a_reference_comes_back_as_it_was(tmp_path, contrast):
    path = tmp_path / 'new' / 'reference.npz'
    for factor in (1, 2):
        save_reference(path, contrast * np.float32(factor), FgerConfig())
        found = load_reference(path, FgerConfig())
        assert found.dtype == np.float32
        assert np.array_equal(found, contrast * np.float32(factor))
    assert [file.name for file in path.parent.iterdir()] == ['reference.npz']


def test_another_preparation_is_refused(tmp_path, contrast):
    path = tmp_path / 'reference.npz'
    save_reference(path, contrast, FgerConfig())
    with pytest.raises(ReferenceFileError, match='another way'):
        load_reference(path, replace(FgerConfig(), log_floor=0.1))


@pytest.mark.parametrize('content', [b'', b'no archive at all', b'PK\x03\x04 cut off'])
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / 'reference.npz'
    path.write_bytes(content)
    with pytest.raises(ReferenceFileError, match='~/tare'):
        load_reference(path, FgerConfig())


def test_every_cut_of_a_file_is_refused(tmp_path, contrast):
    path = tmp_path / 'reference.npz'
    save_reference(path, contrast, FgerConfig())
    data = path.read_bytes()
    for length in range(0, len(data), len(data) // 20):
        path.write_bytes(data[:length])
        with pytest.raises(ReferenceFileError):
            load_reference(path, FgerConfig())


def test_numbers_that_are_not_finite_and_other_shapes_are_refused(tmp_path, contrast):
    path = tmp_path / 'reference.npz'
    contrast[3, 4] = np.nan
    for wrong in (contrast, contrast[1:]):
        save_reference(path, wrong, FgerConfig())
        with pytest.raises(ReferenceFileError, match='no picture'):
            load_reference(path, FgerConfig())


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path, contrast):
    (tmp_path / 'file').write_bytes(b'')
    with pytest.raises(ReferenceFileError, match='cannot be written'):
        save_reference(tmp_path / 'file' / 'reference.npz', contrast, FgerConfig())

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stored no-contact references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_fger.config import FgerConfig
from mixtac_fger.reference import Reference, ReferenceFileError


@pytest.fixture
def reference() -> Reference:
    shape = FgerConfig().frame_shape
    reference = Reference(FgerConfig())
    reference.use(np.random.default_rng(0).normal(size=shape).astype(np.float32))
    return reference


def test_a_reference_comes_back_as_it_was(tmp_path, reference):
    path = tmp_path / 'new' / 'reference.npz'
    for factor in (1, 2):
        reference.use(reference.array * np.float32(factor))
        reference.save(path)
        other = Reference(FgerConfig())
        found = other.load(path)
        assert found.dtype == np.float32
        assert np.array_equal(found, reference.array)
        assert np.array_equal(other.array, reference.array)
    assert [file.name for file in path.parent.iterdir()] == ['reference.npz']


def test_another_preparation_is_refused(tmp_path, reference):
    path = tmp_path / 'reference.npz'
    reference.save(path)
    with pytest.raises(ReferenceFileError):
        Reference(replace(FgerConfig(), log_floor=0.1)).load(path)


@pytest.mark.parametrize('content', [b'', b'no archive at all', b'PK\x03\x04 cut off'])
def test_damaged_files_are_refused(tmp_path, reference, content):
    path = tmp_path / 'reference.npz'
    path.write_bytes(content)
    with pytest.raises(ReferenceFileError) as caught:
        reference.load(path)
    assert '~/tare' in caught.value.remedy


def test_every_cut_of_a_file_is_refused(tmp_path, reference):
    path = tmp_path / 'reference.npz'
    reference.save(path)
    data = path.read_bytes()
    for length in range(0, len(data), len(data) // 20):
        path.write_bytes(data[:length])
        with pytest.raises(ReferenceFileError):
            reference.load(path)


def test_numbers_that_are_not_finite_and_other_shapes_are_refused(tmp_path, reference):
    whole = reference.array.copy()
    whole[3, 4] = np.nan
    for number, wrong in enumerate((whole, whole[1:])):
        path = tmp_path / f'{number}.npz'
        reference.use(wrong)
        reference.save(path)
        with pytest.raises(ReferenceFileError):
            reference.load(path)


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path, reference):
    (tmp_path / 'file').write_bytes(b'')
    with pytest.raises(ReferenceFileError):
        reference.save(tmp_path / 'file' / 'reference.npz')


def test_a_reference_that_is_not_complete_is_not_saved(tmp_path):
    with pytest.raises(ReferenceFileError):
        Reference(FgerConfig()).save(tmp_path / 'reference.npz')

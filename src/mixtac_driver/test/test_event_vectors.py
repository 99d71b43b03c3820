# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Vectors of words, on processors and compilers of all kinds."""

from __future__ import annotations

import numpy as np
import pytest
from llvmlite import binding
from numba import njit

from mixtac_driver.decode import vectors as event_vectors
from mixtac_driver.decode import vectors as vector_press
from mixtac_driver.decode.kernel import pointer_to, source_fingerprint


def taker():
    @njit
    def take(words, t, row, column, polarity):
        return event_vectors.take_vectors(
            pointer_to(words), len(words),
            pointer_to(t), pointer_to(row), pointer_to(column), pointer_to(polarity), len(t),
            0, 0, 1000, 0x8000, 7, 346, 260,
        )  # fmt: skip

    return take


def outputs(words, take):
    out = [np.zeros(1000, kind) for kind in (np.int64, np.uint16, np.uint16, np.uint8)]
    found = take(words, *out)
    return [*found, *(array[: found[1]].tolist() for array in out)]


def expected(words):
    """What the words say, one after the other, in whole groups of 32."""
    stamp, row, n, rows, late = 0x8000, 7, [], 0, 0
    for word in words[: len(words) // 32 * 32].tolist():
        if word >= 0x8000:
            late += word < stamp
            stamp = max(stamp, word)
        elif word >> 12 == 1:
            row, rows = word & 0xFFF, rows + 1
        else:
            n.append((1000 + stamp, row, word & 0xFFF, word >> 12 & 1))
    columns = [list(column) for column in zip(*n, strict=True)]
    return [len(words) // 32 * 32, len(n), rows, late, stamp, row, *columns]


@pytest.mark.parametrize('way', ['press_at_once', 'press_by_fours', 'press_one_by_one'])
def test_words_come_out_as_they_say(monkeypatch, way):
    if way == 'press_by_fours' and not binding.get_host_cpu_features().get('bmi2'):
        pytest.skip('this processor lacks BMI2')
    if way == 'press_at_once' and binding.llvm_version_info < vector_press.COMPRESSING_LLVM:
        pytest.skip('this compiler cannot press vectors')
    called, press = [], getattr(vector_press, way)
    monkeypatch.setattr(event_vectors, 'press', lambda *a: called.append(a) or press(*a))
    rng = np.random.default_rng(1)
    take = taker()
    for _ in range(50):
        kinds = rng.choice([1, 2, 3, 8], 500)
        words = np.where(kinds == 8, 0x8000 | rng.integers(0, 0x8000, 500), kinds << 12)
        words = (words | rng.integers(0, 250, 500)).astype('<u2')
        assert outputs(words, take) == expected(words)
    assert called


def test_fingerprint_changes_with_the_sources(tmp_path):
    def fingerprint():
        return source_fingerprint('*_kernel.py', 'state.py', folder=tmp_path)

    (tmp_path / 'a_kernel.py').write_text('a = 1')
    (tmp_path / 'state.py').write_text('b = 1')
    first = fingerprint()
    (tmp_path / 'other.py').write_text('c = 1')
    assert fingerprint() == first
    (tmp_path / 'state.py').write_text('b = 2')
    assert fingerprint() != first

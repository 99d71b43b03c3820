# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stored no-contact references, when the zero may be renewed, and how its drift is followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_sensor import SOUND

from mixtac_core.node.files import FileError
from mixtac_fger.config import FgerConfig
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.reference import CONTACT, REST_FRAMES, Reference, TareError, Zero
from mixtac_fger.validity import PictureFigures


def picture(outward: float, unlike: float = 0.0) -> PictureFigures:
    tiles = unlike * SOUND.pattern
    return SOUND._replace(outward=outward, residual=tiles, change=tiles)


@pytest.fixture
def reference(model) -> Reference:
    """Return a reference of still frames."""
    found = FgerEstimator(model).reference
    shown = np.zeros(FgerConfig.from_dict(model.config).frame_shape, np.float32)
    for _ in range(found.frames):
        found.add(shown)
    return found


@pytest.mark.parametrize(
    ('outward', 'released'),
    [
        ((), False),
        ((0.0,), False),
        ((2.0 * CONTACT, 0.0), False),
        ((3.0 * CONTACT, 0.0), True),
        ((3.0 * CONTACT,), False),
        ((-2.0 * CONTACT,), True),
        ((3.0 * CONTACT, 0.0, 2.0 * CONTACT), False),
    ],
)
def test_a_release_draws_the_skin_together(reference, outward, released):
    zero = Zero(reference)
    for each in outward:
        zero.frame(picture(each), 0.0, light=True)
    assert zero.released == released
    if released:
        zero.renew(picture(outward[-1]), [0.0], 0.1)
        assert reference.known
        assert not zero.released
        return
    with pytest.raises(TareError):
        zero.renew(picture(0.0), [0.0], 0.1)
    assert not reference.known


@pytest.mark.parametrize(
    ('shown', 'force', 'accepted'),
    [
        (picture(0.0), 0.0, True),
        (picture(0.0), 0.2, False),
        (picture(0.0), -0.2, False),
        (picture(2.0 * CONTACT), 0.0, False),
        (picture(-2.0 * CONTACT), 0.0, False),
        (picture(2.0 * CONTACT, unlike=0.9), 0.0, True),
        (None, 0.0, True),
    ],
    ids=['free', 'force', 'pull', 'pressed', 'drawn', 'another gel', 'no picture'],
)
def test_a_known_zero_is_not_renewed_in_contact(reference, shown, force, accepted):
    reference.use(reference.array)
    zero, before = Zero(reference), reference.number
    if accepted:
        zero.renew(shown, [0.01, force, 0.0], 0.1)
    else:
        with pytest.raises(TareError):
            zero.renew(shown, [0.01, force, 0.0], 0.1)
    assert (reference.number != before) == accepted


def test_drift_is_the_mean_force_at_rest(reference):
    reference.assume_free = True
    zero, random = Zero(reference), np.random.default_rng(2)
    free, pressed = picture(0.0), picture(2.0 * CONTACT)
    for force in random.normal(0.04, 0.02, 200):
        zero.frame(free, force, light=True)
    assert zero.drift == pytest.approx(0.04, abs=0.01)
    assert not zero.due
    before = zero.drift
    for shown, light in ((pressed, True), (pressed, False), (free, False)) * 30:
        zero.frame(shown, 1.0, light=light)
    assert zero.drift == before
    for rest in range(REST_FRAMES):
        assert zero.due == (rest >= REST_FRAMES)
        zero.frame(free, 0.0, light=True)
    assert zero.due
    assert abs(zero.drift) < 0.02


@pytest.fixture
def stored() -> Reference:
    stored = Reference(FgerConfig())
    shape = FgerConfig().frame_shape
    stored.use(np.random.default_rng(0).normal(size=shape).astype(np.float32))
    return stored


def test_a_reference_comes_back_as_it_was(tmp_path, stored):
    path = tmp_path / 'new' / 'reference.npz'
    for factor in (1, 2):
        stored.use(stored.array * np.float32(factor))
        stored.save(path)
        other = Reference(FgerConfig())
        found = other.load(path)
        assert found.dtype == np.float32
        assert np.array_equal(found, stored.array)
        assert np.array_equal(other.array, stored.array)
    assert [file.name for file in path.parent.iterdir()] == ['reference.npz']
    with pytest.raises(FileError):
        Reference(replace(FgerConfig(), log_floor=0.1)).load(path)


def test_damaged_files_are_refused(tmp_path, stored):
    path = tmp_path / 'reference.npz'
    stored.save(path)
    data = path.read_bytes()
    for content in (*(data[: len(data) * k // 20] for k in range(20)), b'no archive at all'):
        path.write_bytes(content)
        with pytest.raises(FileError) as caught:
            stored.load(path)
        assert '~/tare' in caught.value.remedy
    nowhere = stored.array.copy()
    nowhere[3, 4] = np.nan
    for wrong in (nowhere, nowhere[1:] * 0.0):
        stored.use(wrong)
        stored.save(path)
        with pytest.raises(FileError):
            stored.load(path)


def test_a_reference_that_cannot_be_saved_is_a_clear_error(tmp_path, stored):
    with pytest.raises(FileError):
        Reference(FgerConfig()).save(tmp_path / 'reference.npz')
    (tmp_path / 'file').write_bytes(b'')
    with pytest.raises(FileError):
        stored.save(tmp_path / 'file' / 'reference.npz')

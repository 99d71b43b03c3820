# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Presets: `easy` is what it always was, and every effect can be seen."""

import hashlib
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
import pytest

from mixtac_sim import SimulationError
from mixtac_sim.world.effects import EASY, GelEffects, LightEffects, Preset, preset
from mixtac_sim.world.instruments import ReferenceSensor
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import TactileSensor
from mixtac_sim.world.trial import simulate_trial


class Pinned(NamedTuple):
    """What a trial of the simulator gives at `easy`.

    `digest` covers events, frames, stamps and reference readings; the rest is the number of events
    and the sums of the frames [DN], of the true normal forces [N] and of the reference's [N].
    """

    digest: str
    events: int
    frames: int
    truth: float
    reference: float


# Device seed, trial seed, profile, duration [s].
PINNED = {
    (3, 4, 'impact', 1.2): Pinned('da2d17e1ed70acad', 237786, 356426358, 166.005929646, 139.96135),
    (5, 6, 'press', 1.8): Pinned('cbd9191233d5062c', 74697, 295521914, 714.898051478, 597.7796),
    (7, 8, 'static', 1.0): Pinned('0f32efe264a90a89', 23628, 207643666, 326.032509407, 245.2915),
    (9, 10, 'oscillation', 1.0): Pinned(
        '9db159945fbd03b9', 41269, 298646590, 387.781585575, 298.92965
    ),
}
# Digests of exp, log, sin and cos as NumPy computes them on x86-64, with AVX-512 and without. With
# both, with every BLAS kernel and with Numba's `generic` code the trials are the same but for the
# last bits of the true force (1e-12 N).
MATHS = ('fcbb2901190becb4', 'b295be7bd5acb1b4')


def maths():
    grid = np.linspace(0.001, 20.0, 20_001)
    values = np.stack([np.exp(-grid), np.log(grid), np.sin(grid), np.cos(grid)])
    return hashlib.sha256(values.tobytes()).hexdigest()[:16]


def digest(trial):
    """Return a digest of what the instruments gave: integers and the reference's readings."""
    found, e = hashlib.sha256(), trial.events
    for array in (
        *(e.t, e.x, e.y, e.polarity, trial.frames, trial.exposure_start_us, trial.arrival_us),
        *(trial.reference_t_us, trial.reference_wrench),
    ):
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


@pytest.mark.parametrize('arguments', PINNED)
def test_easy_is_what_it_always_was(arguments):
    trial, pinned = simulate_trial(*arguments), PINNED[arguments]
    assert len(trial.events) == pytest.approx(pinned.events, rel=1e-4)
    assert trial.frames.sum(dtype=np.int64) == pytest.approx(pinned.frames, rel=1e-6)
    assert trial.truth['fz'].sum() == pytest.approx(pinned.truth, rel=1e-9)
    assert trial.reference_wrench.sum() == pytest.approx(pinned.reference, rel=1e-6)
    if maths() in MATHS:
        assert digest(trial) == pinned.digest


def outcome(chosen):
    profile = make_profile('impact', 5, 1.0, preset=chosen)
    output = TactileSensor(11, 5, profile, preset=chosen).advance(260_000)
    samples = ReferenceSensor(5, preset=chosen).process(output.wrench_us, output.wrench)
    return len(output.events), output.frames[2].intensity.sum(), samples.wrench.sum()


@pytest.fixture(scope='module')
def full():
    return outcome(preset('hard'))


@pytest.mark.parametrize('effect', [each.name for each in fields(Preset)])
def test_every_effect_can_be_seen(full, effect):
    assert full != outcome(replace(preset('hard'), **{effect: getattr(EASY, effect)}))


def idle(**effects):
    """Return frames of 0.5 s without contact [n, 260, 346], and the share of ON events."""
    trial = simulate_trial(1, 2, 'idle', 0.5, preset=replace(EASY, **effects))
    return trial.frames.astype(float), trial.events.polarity.mean()


def test_a_lamp_that_drifts_changes_frames_and_events():
    rates = ((0.1, 0.1), (-0.1, -0.1))
    (up, more), (down, less) = (idle(light=LightEffects(supply_per_s=each)) for each in rates)
    assert up[-1].mean() / up[0].mean() == pytest.approx(1.045, abs=0.01)
    assert down[-1].mean() / down[0].mean() == pytest.approx(0.955, abs=0.01)
    assert more > less + 0.2


def test_gel_that_grows_moves_what_is_far_from_the_axis():
    frames = [idle(gel=GelEffects(growth_per_s=(rate, rate)))[0] for rate in (0.0, 0.01)]
    steady, grown = (np.abs(each[-1] - each[0]) for each in frames)
    more = (grown - steady) / steady.mean()
    assert more[:, :60].mean() > 0.2
    assert abs(more[120:140, 162:182].mean()) < 0.1


def test_a_second_contact_adds_its_force():
    one, two = (
        simulate_trial(1, 2, 'press', 1.5, preset=replace(EASY, contact=contact))
        for contact in (EASY.contact, replace(EASY.contact, second=(0.5, 0.5)))
    )
    np.testing.assert_allclose(two.truth['fz'], 1.5 * one.truth['fz'])
    assert len(two.events) > 1.1 * len(one.events)


def test_an_unknown_preset_is_refused():
    with pytest.raises(SimulationError, match="'easier'"):
        preset('easier')

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole sensor: repeatable, independent of how it is advanced, and alive."""

from dataclasses import replace

import numpy as np
import pytest

from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.effects import EASY, BandwidthEffects, LightEffects, PixelEffects
from mixtac_sim.world.segments import Profile, Segment, Tone
from mixtac_sim.world.sensor import TactileSensor


def tap(duration=1.0, start=0.1, force=0.8):
    press = Segment(start, start + 0.3, Mode.FORCE, (0.0, 0.1, 0.2, 0.3), (0.0, force, force, 0.0))
    return Profile(duration, (press,))


def sensor(device=1, trial=2, profile=None, pixels=None, aps=None, preset=EASY):
    body = TactileSensor(device, trial, profile or tap(), preset=preset)
    if pixels is not None:
        body.configure_pixels(pixels)
    if aps is not None:
        body.configure_aps(aps)
    return body


def same_events(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ('t', 'x', 'y', 'polarity')
    )


@pytest.fixture(scope='module')
def whole():
    return sensor().advance(400_000)


@pytest.mark.parametrize('step_us', [1_000, 1_237, 50_000])
def test_pieces_give_what_the_whole_gives(whole, step_us):
    body = sensor()
    times = [*range(step_us, 400_000, step_us), 400_000]
    parts = [body.advance(t) for t in times]
    events = type(whole.events).concatenate([p.events for p in parts])
    assert same_events(events, whole.events)
    frames = [f for p in parts for f in p.frames]
    assert len(frames) == len(whole.frames) > 8
    for frame, other in zip(frames, whole.frames, strict=True):
        assert frame.exposure_start_us == other.exposure_start_us
        np.testing.assert_array_equal(frame.reset, other.reset)
        np.testing.assert_array_equal(frame.signal, other.signal)
    np.testing.assert_array_equal(np.concatenate([p.truth for p in parts]), whole.truth)
    np.testing.assert_array_equal(np.concatenate([p.wrench for p in parts]), whole.wrench)
    for part, end in zip(parts, times, strict=True):
        assert len(part.events) == 0 or part.events.t[-1] < end


def test_seeds_fix_everything_and_matter(whole):
    assert same_events(sensor().advance(400_000).events, whole.events)
    other_day = sensor(trial=3).advance(50_000)
    other_device = sensor(device=9).advance(50_000)
    first = sensor().advance(50_000)
    assert not same_events(first.events, other_day.events)
    rest = first.frames[0].intensity.astype(float)
    assert np.corrcoef(rest.ravel(), other_day.frames[0].intensity.ravel())[0, 1] > 0.99
    assert np.corrcoef(rest.ravel(), other_device.frames[0].intensity.ravel())[0, 1] < 0.9


def test_events_integrate_to_the_change_of_the_image():
    """Signed events over a press follow the change of log intensity between two frames."""
    settings = PixelSettings(0.15, 0.15, shot_hz=0.0, leak_hz=0.0, leak_hz_per_lux=0.0)
    output = sensor(pixels=settings).advance(300_000)
    before, during = output.frames[0], output.frames[6]
    middle = [(f.exposure_start_us + f.exposure_end_us) // 2 for f in (before, during)]
    events = output.events.between(*middle)
    total = np.zeros((260, 346))
    np.add.at(total, (events.y, events.x), np.where(events.polarity, 1.0, -1.0))
    change = np.log((during.intensity + 5.0) / (before.intensity + 5.0))
    strong = np.abs(change) > 0.5
    assert strong.sum() > 300
    assert np.corrcoef(total[strong], change[strong])[0, 1] > 0.85


def test_truth_is_what_was_commanded(whole):
    truth = whole.truth
    np.testing.assert_array_equal(np.diff(truth['t_us']), 1_000)
    held = truth[(truth['t_us'] > 205_000) & (truth['t_us'] < 295_000)]
    np.testing.assert_allclose(held['fz'], 0.8)
    assert np.all(held['depth_mm'] > 0.2)
    assert np.all(truth['fz'][truth['t_us'] < 100_000] == 0.0)
    shear = np.hypot(held['fx'], held['fy'])
    assert np.all(shear <= 1.2 * held['fz'])
    assert len(whole.wrench) == 8 * len(truth) + 7


def test_settings_reach_pixels_and_frames():
    quiet = PixelSettings(2.0, 2.0, shot_hz=0.0, leak_hz=0.0, leak_hz_per_lux=0.0)
    body = sensor(pixels=quiet, aps=ApsSettings(first_us=200_000))
    output = body.advance(200_000)
    assert output.frames == []
    few = len(output.events)
    body.configure_pixels(PixelSettings(0.1, 0.1))
    body.configure_aps(ApsSettings(3_000, 20_000))
    output = body.advance(400_000)
    assert len(output.events) > 5 * few
    assert len(output.frames) in {9, 10}
    assert output.frames[0].exposure_end_us - output.frames[0].exposure_start_us == 3_000


def rubbed(move):
    press = Segment(0.1, 0.2, Mode.FORCE, (0.0, 0.1), (0.0, 0.6))
    held = Segment(0.2, 0.5, Mode.FORCE, (0.0,), (0.6,), move=move)
    return Profile(0.6, (press, held, Segment(0.5, 0.6, Mode.FORCE, values=(0.6,))))


# A turn of the skin dies out below it: beads, which lie deeper, follow it little.
@pytest.mark.parametrize(
    ('move', 'name', 'events_more', 'change'),
    [((1.5, 0.0, 0.0), 'fx', 1.5, 1.4), ((0.0, 0.0, 0.6), 'tz', 1.15, 1.05)],
)
def test_a_slide_and_a_turn_are_felt_and_seen(move, name, events_more, change):
    output = sensor(profile=rubbed(move)).advance(600_000)
    felt = dict(zip(output.truth['t_us'].tolist(), output.truth[name].tolist(), strict=True))
    assert felt[500_000] > 20.0 * abs(felt[200_000])
    assert output.truth['fz'][-1] == pytest.approx(0.6)
    # The friction of a slide is coefficient times force; that of the device is 0.5 to 1.3.
    if name == 'fx':
        assert 0.4 < felt[500_000] / 0.6 < 1.5
    events = output.events
    moving, still = (len(events.between(t, t + 100_000)) for t in (200_000, 500_000))
    assert moving > events_more * still
    frames = [frame.intensity.astype(int) for frame in output.frames]
    noise = np.abs(frames[-1] - frames[-2]).mean()
    assert np.abs(frames[-1] - frames[5]).mean() > change * noise


def test_a_sliding_contact_does_not_depend_on_how_it_is_advanced():
    whole = sensor(profile=rubbed((0.8, 0.9, 0.1))).advance(400_000)
    body = sensor(profile=rubbed((0.8, 0.9, 0.1)))
    parts = [body.advance(t) for t in (1_237, 290_000, 400_000)]
    assert same_events(type(whole.events).concatenate([p.events for p in parts]), whole.events)
    np.testing.assert_array_equal(np.concatenate([p.wrench for p in parts]), whole.wrench)


QUIET = {'shot_hz': 0.0, 'leak_hz': 0.0, 'leak_hz_per_lux': 0.0}
NO_FRAMES = ApsSettings(first_us=10**9)
EVEN = replace(
    EASY,
    pixels=PixelEffects(0.0, 0.0, (0.0, 0.0), (0.0, 0.0), 0.0),
    light=LightEffects(drift_per_s=(0.0, 0.0), hot_pixels=(0, 1), frame_burst=(0.0, 0.0)),
)


def shake(frequency, settings, preset=EVEN, seconds=0.8):
    """Return the events of the last half second of a press that vibrates by 0.1 mm."""
    press = Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (-0.1, 0.5))
    tone = Tone(0.1, frequency, 0.0, 0.05)
    hold = Segment(0.2, seconds, Mode.POSITION, (0.0,), (0.5,), (tone,))
    profile = Profile(seconds, (press, hold))
    body = sensor(profile=profile, pixels=settings, aps=NO_FRAMES, preset=preset)
    return body.advance(round(1e6 * seconds)).events.between(300_000, 800_000)


def lines(events, frequency):
    """Return the pooled rate's lines at the drive and at twice it, over the median of all."""
    counts = np.bincount((events.t - 300_000) // 500, minlength=1000)[:1000]
    spectrum = np.abs(np.fft.rfft(counts - counts.mean()))
    return spectrum[[frequency // 2, frequency]] / np.median(spectrum)


@pytest.fixture(scope='module')
def symmetric():
    settings = PixelSettings(0.2, 0.2, **QUIET)
    return {f: shake(f, settings) for f in (60, 200)}


@pytest.mark.parametrize('frequency', [60, 200])
def test_symmetric_motion_gives_a_line_at_twice_the_drive(symmetric, frequency):
    drive, twice = lines(symmetric[frequency], frequency)
    assert twice > 100.0
    assert twice > 10.0 * drive


def test_bandwidth_takes_fast_vibration_away(symmetric):
    without = replace(
        EVEN, bandwidth=BandwidthEffects((1e3, 1e3), (1e3, 1e3), (0.0, 0.0), 0, 0, 0.0)
    )
    settings = PixelSettings(0.2, 0.2, **QUIET)
    slow, fast = (len(shake(f, settings, without)) / f for f in (60, 200))
    assert fast == pytest.approx(slow, rel=0.1)  # events per period: the motion is the same
    assert len(symmetric[200]) / 200 < 0.4 * len(symmetric[60]) / 60
    assert len(symmetric[60]) / 60 < slow

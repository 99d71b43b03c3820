# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate-force` on a simulated recording, and live on the virtual sensor."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import typer

pytest.importorskip('rclpy', reason='needs ROS 2')
from rich.console import Console
from typer.testing import CliRunner

from mixtac import loads as known_loads
from mixtac.calibrate_force import calibrate_force, parse_loads
from mixtac.loads import LiveProcedure, estimated
from mixtac_core.node.process import GraphError
from mixtac_core.recordings import camera_stream
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import SERIAL_KEY
from mixtac_fger.force_calibration import GRAVITY, PULL, ForceCalibrationError, fit_gain
from mixtac_fger.weights import find_model, read_model
from mixtac_sim.bags.trial_bag import write_trial
from mixtac_sim.usb.endpoints import serial_number

DEVICE = 500_001
GRAMS = [20.0, 50.0, 100.0]


def head(model):
    """Return a number in proportion to the forces of a model."""
    return float(model.tensors['frame.press'].sum())


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a simulated recording of three weights, with a reference sensor.

    Its forces are estimated once. A calibrated model multiplies them by its gain (`test_shear`).
    """
    folder, known = tmp_path_factory.mktemp('bags'), {}
    spec = TrialSpec('weights', 'weights', 17.0, DEVICE, 7, 'easy', 'train')

    def once(recording, model):
        if not known:
            known.update(forces=estimated(recording, model), head=head(model))
        t_us, forces = known['forces']
        return t_us, forces * head(model) / known['head']

    with pytest.MonkeyPatch.context() as patch:
        write_trial(spec, folder)
        patch.setattr(known_loads, 'estimated', once)
        yield folder / spec.name


def held(*levels):
    """Return normal force, x and y [N] at 500 Hz that rest at each level for 2 s."""
    table = np.array(levels)
    rows = [np.repeat(table[:1], 1000, axis=0)]
    for before, after in pairwise(table):
        rows += [np.linspace(before, after, 100), np.repeat([after], 1000, axis=0)]
    return np.concatenate(rows)


@pytest.fixture
def pulled(tmp_path, monkeypatch):
    """Return a recording with 50 g and 100 g, and with 100 g that 20 g pull to +x and to +y.

    The estimate is 1.25 times too small, that of the sideways force 2 times.
    """
    free, half, press = (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.1, 0.002, -0.001)
    levels = [free, half, free, press, free, press, (0.1, 0.022, -0.001), press]
    levels += [(0.1, 0.002, 0.019), press, free]
    forces = GRAVITY * held(*levels) / [1.25, 2.0, 2.0]
    forces += np.random.default_rng(1).normal(0.0, 0.003, forces.shape)
    estimates = 2000 * np.arange(len(forces), dtype=np.int64), forces
    monkeypatch.setattr(known_loads, 'estimated', lambda *_: estimates)
    monkeypatch.setattr(camera_stream, 'open_recording', lambda _: io.BytesIO())
    path = tmp_path / 'recording.aedat4'
    path.touch()
    return path


def test_sideways_loads_give_the_gain_of_the_sideways_force(pulled, tmp_path):
    out, figures = tmp_path / 'm.safetensors', tmp_path / 'f.json'
    words = ('--bag', pulled, '--loads', '50,100', '--out', out, '--json', figures)
    result = calibrate(*words, '--sideways-loads', '20,20')
    assert result.exit_code == 0, result.output
    found = json.loads(figures.read_text())
    sideways = found['sideways']
    assert found['gain'] == pytest.approx(1.25, rel=0.02)
    # Beside that of the normal force.
    assert sideways['pulled_gain'] == pytest.approx(2.0 / 1.25, rel=0.03)
    assert 1.0 < sideways['gain'] < sideways['pulled_gain']
    model, shipped = (read_model(find_model(name)) for name in (str(out), 'fger_small'))
    assert model.card.training['calibrated']['sideways'] == sideways
    unit = model.tensors['shear.unit'] / shipped.tensors['shear.unit']
    applied = sideways['gain'] * found['gain']
    assert unit == pytest.approx([applied] * 3, rel=1e-4)


@pytest.mark.parametrize(
    ('text', 'error'),
    [('20,20,20', 'contact'), ('20', 'few'), ('20g', 'loads'), ('0.02,0.02', 'loads')],
)
def test_pulls_that_are_not_in_the_recording_are_refused(pulled, tmp_path, text, error):
    out = tmp_path / 'm.safetensors'
    words = ('--bag', pulled, '--loads', '50,100', '--out', out)
    result = calibrate(*words, '--sideways-loads', text)
    assert isinstance(result.exception, ForceCalibrationError)
    assert result.exception.reason == error
    assert not out.exists()


def calibrate(*words):
    app = typer.Typer()
    app.command()(calibrate_force)
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope='module')
def done(bag, tmp_path_factory):
    """Calibrate by the recording; return the folder of the results."""
    folder = tmp_path_factory.mktemp('calibrated')
    words = ('--bag', bag, '--out', folder / 'm.safetensors', '--json', folder / 'f.json')
    result = calibrate(*words, '--loads', '20,50,100', '--gel', 'soft')
    assert result.exit_code == 0, result.output
    return folder


def test_a_recording_gives_gain_and_weight_file(done):
    found = json.loads((done / 'f.json').read_text())
    assert found['gain'] == pytest.approx(1.0, abs=0.6)
    assert 0.0 < found['gain_sd'] < 0.06 * found['gain']
    assert max(abs(each['residual_n']) for each in found['loads']) < 0.04
    assert [each['load_g'] for each in found['loads']] == GRAMS
    assert found['known_by'] == 'weights'
    assert (done / 'm.md').is_file()
    model, shipped = (
        read_model(find_model(n)) for n in (str(done / 'm.safetensors'), 'fger_small')
    )
    entry = model.card.training['calibrated']
    assert model.card.training[SERIAL_KEY] == entry['serial'] == serial_number(DEVICE)
    assert (entry['gel'], entry['from']) == ('soft', 'fger_small.safetensors')
    assert head(model) == pytest.approx(entry['gain'] * head(shipped), rel=1e-4)


def test_the_example_calibrates_by_the_same_weights(bag, tmp_path, run_example):
    run_example('calibrate_with_weights', bag)
    assert read_model(tmp_path / 'my_sensor.safetensors').card.training[SERIAL_KEY]


def test_deviations_become_those_of_a_known_gain(done, bag, tmp_path):
    words = ('--bag', bag, '--loads', '20,50,100', '--model', done / 'm.safetensors')
    result = calibrate(*words, '--out', tmp_path / 'again.safetensors')
    assert result.exit_code == 0, result.output
    once, twice = map(read_model, (done / 'm.safetensors', tmp_path / 'again.safetensors'))
    # The share of a model for unknown sensors is replaced, not shrunk again and again.
    assert twice.tensors['deviation'][1] == pytest.approx(once.tensors['deviation'][1], rel=0.05)


def test_a_check_passes_on_the_sensor_and_fails_by_other_loads(done, bag, tmp_path):
    words = ('--bag', bag, '--check', '--model', done / 'm.safetensors')
    result = calibrate(*words, '--loads', '20,50,100', '--json', tmp_path / 'c.json')
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / 'c.json').read_text())['passed']
    result = calibrate(*words, '--loads', '30,75,150', '--json', tmp_path / 'c.json')
    assert isinstance(result.exception, ForceCalibrationError)
    assert result.exception.reason == 'loads'


def test_a_reference_sensor_in_the_recording_is_used(done, bag, tmp_path):
    words = ('--bag', bag, '--out', tmp_path / 'm.safetensors', '--json', tmp_path / 'f.json')
    result = calibrate(*words)
    assert result.exit_code == 0, result.output
    found, by_weights = (json.loads((each / 'f.json').read_text()) for each in (tmp_path, done))
    assert found['known_by'] == 'reference'
    assert found['gain'] == pytest.approx(by_weights['gain'], rel=0.08)


@pytest.mark.parametrize(
    ('loads', 'reason'),
    [('100,50,20', 'loads'), ('.02,.05,.1', 'loads'), ('20,50,100,150', 'contact')],
)
def test_a_refusal_leaves_nothing_behind(bag, tmp_path, loads, reason):
    words = ('--out', tmp_path / 'm.safetensors', '--json', tmp_path / 'f.json')
    result = calibrate('--bag', bag, '--loads', loads, *words)
    assert isinstance(result.exception, ForceCalibrationError)
    assert result.exception.reason == reason
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_or_checked_is_refused_first(bag, tmp_path):
    for words in (
        ('--bag', bag),
        ('--bag', bag, '--out', tmp_path / 'm.bin'),
        ('--bag', bag, '--check'),
        ('--bag', bag, '--check', '--sideways-loads', '20'),
    ):
        assert isinstance(calibrate(*words).exception, ModelError)


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        *((each, 'loads') for each in ('fifty', '50,,100', '-5', 'inf', 'nan')),
        *(('100', 'few'), ('100,105', 'few')),
    ],
)
def test_impossible_loads_are_refused_before_anything_starts(tmp_path, text, reason):
    result = calibrate('--loads', text, '--out', tmp_path / 'm.safetensors')
    assert isinstance(result.exception, ForceCalibrationError)
    assert result.exception.reason == reason


def test_loads_are_grams():
    found = parse_loads('20, 50,100.5', 1.0)
    assert [load.grams for load in found] == pytest.approx([20.0, 50.0, 100.5])


@pytest.mark.dds
@pytest.mark.timeout(600)
def test_the_virtual_sensor_is_calibrated_live(ros_domain, tmp_path):
    model, figures = tmp_path / 'm.safetensors', tmp_path / 'f.json'
    words = [sys.executable, '-m', 'mixtac', 'calibrate-force', '--device', 'virtual', '--yes']
    words += ['--loads', '50,100', '--out', str(model), '--json', str(figures)]
    result = subprocess.run(
        words, env=ros_domain, capture_output=True, text=True, timeout=500, check=False
    )
    assert result.returncode == 0, result.stderr
    found = json.loads(figures.read_text())
    assert 0.2 < found['gain'] < 5.0
    for each in found['loads']:
        assert abs(each['residual_n']) < 0.1
    assert read_model(model).card.training[SERIAL_KEY] == found['serial'] != ''


class Operated:
    """Monitor and nodes of a sensor that reads 0.8 of presses and 0.5 of pulls; time is simulated.

    Each look at the force shows 0.2 s more.
    """

    def __init__(self):
        self.load, self.refusals = (0.0, 0.0, 0.0), 0
        self.rows = np.zeros((1, 4))
        self.serial, self.random = 'virtual', np.random.default_rng(1)
        self.processes = SimpleNamespace(check=lambda: None)
        self.estimate = SimpleNamespace(samples=self.estimates)
        self.measured = SimpleNamespace(received=1, samples=self.references)

    def touch(self, gesture, *, hold, force=0.0, pull=0.0, pull_direction=0.0):
        assert (hold, pull_direction) == (0.0, 0.0)
        self.load = (0.0, 0.0, 0.0) if gesture == 'release' else (force, pull, 0.0)

    def trigger(self, service):
        """Refuse once, as an estimator does that has lost a frame; nothing changes at a tare."""
        self.refusals += 1
        if self.refusals == 1:
            raise GraphError('there are no estimates yet')

    def table(self):
        stamps = self.rows[:, 0].astype(np.int64)
        return np.array([stamps + 5_000_000, stamps]), self.rows[:, 1:]

    def estimates(self):
        stamps = 2e6 * (len(self.rows) + np.arange(50))
        forces = np.array(self.load) * (0.8, 0.5, 0.5) + self.random.normal(0, 1e-3, (50, 3))
        self.rows = np.vstack([self.rows, np.column_stack([stamps, forces])])
        return self.table()

    def references(self):
        times, forces = self.table()
        return times, forces / (0.8, 0.5, 0.5) + (0.1, 0.0, 0.0)


@pytest.mark.parametrize('measured', [False, True])
def test_a_live_sensor_is_led_through_loads_and_pulls(monkeypatch, measured):
    monkeypatch.setattr(known_loads, 'POLL_S', 0.0)
    live = LiveProcedure(Console(quiet=True), Operated(), drives=True)
    found = live.lead(parse_loads('20,50,100', 1.0), parse_loads('20,20', 1.0))
    if measured:
        found.measure(*live.reference())
    assert fit_gain(found.loads, found.plateaus).gain == pytest.approx(1.25, rel=0.02)
    assert fit_gain(found.pull_loads, found.pulls, PULL).gain == pytest.approx(2.0, rel=0.03)


def test_a_load_that_never_arrives_is_refused(monkeypatch):
    monkeypatch.setattr(known_loads, 'POLL_S', 0.0)
    with pytest.raises(ForceCalibrationError) as caught:
        LiveProcedure(Console(quiet=True), Operated()).lead(parse_loads('20,50', 1.0), [])
    assert caught.value.reason == 'contact'

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the doctor says of the computer, on made-up system files."""

from __future__ import annotations

import os
import shutil
import subprocess
from types import SimpleNamespace

import pytest

from mixtac_driver.doctor import computer
from mixtac_driver.doctor.computer import HostFiles, Level


def write(root, absolute, text):
    path = root / absolute.lstrip('/')
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'{text}\n')
    return HostFiles(root)


@pytest.mark.parametrize(
    ('governor', 'driver', 'level'),
    [
        ('performance', 'acpi-cpufreq', Level.OK),
        ('schedutil', 'acpi-cpufreq', Level.OK),
        ('powersave', 'intel_pstate', Level.OK),
        ('powersave', 'acpi-cpufreq', Level.WARN),
        ('ondemand', 'acpi-cpufreq', Level.WARN),
    ],
)
def test_governor(tmp_path, monkeypatch, governor, driver, level):
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1, 2, 3})
    write(tmp_path, f'{computer.CPUS}/cpu0/cpufreq/scaling_driver', driver)
    write(tmp_path, f'{computer.CPUS}/cpu0/cpufreq/scaling_governor', 'performance')
    files = write(tmp_path, f'{computer.CPUS}/cpu1/cpufreq/scaling_governor', governor)
    finding = computer.check_processor(files)
    assert finding.level is level
    assert finding.values['cores'] == 4
    assert ('cpupower' in finding.remedy) == (level > Level.OK)


def test_a_single_core_is_too_few(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0})
    finding = computer.check_processor(HostFiles(tmp_path))
    assert (finding.level, finding.values['governor']) == (Level.WARN, 'not visible')


def test_clock():
    assert computer.check_clock(True, 0.002).level is Level.OK
    assert 'chrony' in computer.check_clock(False, 16.0).remedy
    assert computer.check_clock(None, 0.0).level is Level.OK


@pytest.mark.skipif(shutil.which('timedatectl') is None, reason='no timedatectl to compare with')
def test_the_kernel_and_timedatectl_agree():
    command = ['timedatectl', 'show', '--property=NTPSynchronized', '--value']
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        pytest.skip('timedatectl does not run here')
    assert computer.kernel_clock()[0] == (run.stdout.strip() == 'yes')


def test_the_kernel_tells_of_its_clock():
    synchronised, error_s = computer.kernel_clock()
    assert isinstance(synchronised, bool)
    # The kernel never assumes more than 16 s.
    assert 0 <= error_s <= 16


@pytest.mark.parametrize(('free_gb', 'level'), [(50, Level.OK), (9, Level.WARN)])
def test_disk(tmp_path, monkeypatch, free_gb, level):
    usage = SimpleNamespace(free=free_gb * 10**9)
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: usage)
    finding = computer.check_disk(tmp_path)
    assert (finding.level, finding.values) == (level, {'free [GB]': free_gb})


def test_all_of_the_computer_is_looked_at(tmp_path):
    names = [finding.name for finding in computer.check_computer(HostFiles(), tmp_path)]
    assert names == ['processor', 'disk', 'real-time clock']

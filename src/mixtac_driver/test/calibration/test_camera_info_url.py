# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""URLs as camera_info_manager knows them."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixtac_driver.calibration.camera_info import resolve
from mixtac_driver.calibration.lens import CalibrationError


@pytest.mark.parametrize(
    ('url', 'path'),
    [
        ('', '/ros home/camera_info/left.yaml'),
        ('file:///tmp/cam.yaml', '/tmp/cam.yaml'),
        ('file:///tmp/a%20b.yaml', '/tmp/a b.yaml'),
        ('file://${ROS_HOME}/x/${NAME}.yaml', '/ros home/x/left.yaml'),
        ('/tmp/${NAME}.yaml', '/tmp/left.yaml'),
        ('~/c.yaml', '/home of mine/c.yaml'),
    ],
)
def test_urls_name_files(monkeypatch, url, path):
    monkeypatch.setenv('ROS_HOME', '/ros home')
    monkeypatch.setenv('HOME', '/home of mine')
    assert resolve(url, 'left') == Path(path)


def test_without_ros_home_it_is_in_the_users_home(monkeypatch):
    monkeypatch.delenv('ROS_HOME', raising=False)
    monkeypatch.setenv('HOME', '/home/of')
    assert resolve('', 'cam') == Path('/home/of/.ros/camera_info/cam.yaml')


def test_a_relative_path_is_one_of_the_working_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert resolve('camera.yaml', 'cam') == tmp_path / 'camera.yaml'


def test_packages_are_looked_up():
    pytest.importorskip('ament_index_python')
    path = resolve('package://mixtac_driver/calibration/${NAME}.yaml', 'cam')
    assert path.is_absolute()
    assert path.parts[-4:] == ('share', 'mixtac_driver', 'calibration', 'cam.yaml')


@pytest.mark.parametrize(
    ('url', 'said'),
    [
        ('http://host/cam.yaml', 'use file:///path'),
        ('file://relative.yaml', 'three slashes'),
        ('/tmp/${HOSTNAME}.yaml', r'\$\{HOSTNAME\} is unknown'),
        ('package://no_such_package/cam.yaml', 'no package no_such_package'),
        ('package://mixtac_driver', 'give package://name/path.yaml'),
    ],
)
def test_what_is_wrong_with_a_url_is_said(url, said):
    with pytest.raises(CalibrationError, match=said):
        resolve(url, 'cam')


@pytest.mark.parametrize('name', ['', 'a b', '../x', 'a/b'])
def test_names_that_are_no_file_names_are_refused(name):
    with pytest.raises(CalibrationError):
        resolve('', name)

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera_info YAML: what others write is read, what is damaged is named."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from lenses import calibration, calibrations

from mixtac_driver.calibration.camera_info import (
    format_camera_info,
    parse_camera_info,
    read_camera_info,
    write_camera_info,
)
from mixtac_driver.calibration.lens import MODELS, CalibrationError
from mixtac_node.files import FileError

# As camera_calibration_parsers writes it (its documentation's example).
OTHERS = """image_width: 2448
image_height: 2050
camera_name: prosilica
camera_matrix:
  rows: 3
  cols: 3
  data: [4827.94, 0, 1223.5, 0, 4835.62, 1024.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.41527, 0.31874, -0.00197071, 7.13084e-05, 1e-05]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [4827.94, 0, 1223.5, 0, 0, 4835.62, 1024.5, 0, 0, 0, 1, 0]
"""


def test_a_file_of_camera_calibration_parsers_is_read():
    camera = parse_camera_info(OTHERS)
    assert (camera.width, camera.height, camera.name) == (2448, 2050, 'prosilica')
    assert camera.distortion.tolist() == [-0.41527, 0.31874, -0.00197071, 7.13084e-05, 1e-05]
    assert camera.projection[1].tolist() == [0, 4835.62, 1024.5, 0]


@pytest.mark.parametrize('model', MODELS)
@given(data=st.data(), name=st.text(max_size=30))
@settings(max_examples=30)
def test_what_is_written_is_read_to_the_last_bit(model, data, name):
    camera = data.draw(calibrations(model))
    text = format_camera_info(camera, 'two\nlines')
    read = parse_camera_info(text)
    assert (read.size, read.model) == (camera.size, camera.model)
    for field in ('distortion', 'camera_matrix', 'rectification', 'projection'):
        np.testing.assert_array_equal(getattr(read, field), getattr(camera, field))
    # Every number must be one for YAML 1.1 readers too.
    for block in yaml.safe_load(text).values():
        if isinstance(block, dict):
            assert all(isinstance(each, float) for each in block['data'])


@given(name=st.text(st.characters(codec='utf-8', exclude_categories=['Cs', 'Cc']), max_size=30))
@settings(max_examples=50)
def test_any_name_survives(name):
    assert parse_camera_info(format_camera_info(calibration(name=name))).name == name


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('image_width: 2448', 'image_width: wide', 'image_width'),
        ('image_width: 2448', 'image_width: 0', 'image size 0x2050'),
        ('image_height: 2050\n', '', 'image_height is missing'),
        ('plumb_bob', 'ftheta', "'ftheta' is unknown: use plumb_bob, rational_polynomial"),
        ('plumb_bob', 'equidistant', 'is 1x5, must be 1x4'),
        ('cols: 5', 'cols: 4', 'is 1x4, must be 1x5'),
        ('[4827.94, 0, 1223.5, 0, 4835', '[-4827.94, 0, 1223.5, 0, 4835', 'must be positive'),
        ('[4827.94, 0, 1223.5, 0, 0,', '[0, 0, 1223.5, 0, 0,', 'projection_matrix: focal'),
        ('[4827.94, 0, 1223.5, 0, 4835', '[4827.94, 3, 1223.5, 0, 4835', 'skew 3'),
        ('-0.41527', '.nan', 'not finite'),
        ('-0.41527', 'none', "'none' in data is not a number"),
        ('-0.41527', 'true', 'True in data is not a number'),
        ('-0.41527, ', '', 'a list of 5 numbers'),
        ('[1, 0, 0, 0, 1, 0, 0, 0, 1]', '[2, 0, 0, 0, 1, 0, 0, 0, 1]', 'rectification_matrix'),
        ('[1, 0, 0, 0, 1, 0, 0, 0, 1]', '[-1, 0, 0, 0, 1, 0, 0, 0, 1]', 'rectification_matrix'),
        ('0, 0, 1]\ndistortion_model', '0, 0, 2]\ndistortion_model', 'last row'),
        ('camera_name: prosilica', 'camera_name: 7', 'camera_name: 7'),
        ('  data: [1, 0', '  date: [1, 0', 'must have rows, cols and data'),
    ],
)
def test_damage_is_named(tmp_path, old, new, said):
    assert old in OTHERS
    path = tmp_path / 'camera.yaml'
    path.write_text(OTHERS.replace(old, new, 1))
    with pytest.raises(CalibrationError) as caught:
        read_camera_info(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


@given(st.integers(0, len(OTHERS) - 1), st.binary(max_size=3))
@settings(max_examples=150)
def test_damage_anywhere_is_refused_or_harmless(place, junk):
    text = OTHERS[:place] + junk.decode('latin-1') + OTHERS[place + len(junk) + 1 :]
    try:
        camera = parse_camera_info(text)
    except CalibrationError:
        return
    assert np.isfinite(camera.camera_matrix).all()


@pytest.mark.parametrize(
    'text', ['', '- 1', '{', '!!python/object:os.system x', '\0', 'a: &a [*a]']
)
def test_what_is_no_camera_info_is_refused(text):
    with pytest.raises(CalibrationError):
        parse_camera_info(text)


def test_aliases_that_expand_are_not_shown():
    # The error would show the value.
    bomb = 'v0: &v0 [many, many]\n'
    bomb += ''.join(f'v{n}: &v{n} [{", ".join([f"*v{n - 1}"] * 20)}]\n' for n in range(1, 5))
    text = re.sub(r'image_width: \d+', 'image_width: *v4', OTHERS, count=1)
    with pytest.raises(CalibrationError) as caught:
        parse_camera_info(bomb + text)
    assert len(str(caught.value)) < 1000


def test_a_cut_off_file_is_refused(tmp_path):
    path = tmp_path / 'camera.yaml'
    for length in range(0, len(OTHERS) - 5, 20):
        path.write_text(OTHERS[:length])
        with pytest.raises(CalibrationError):
            read_camera_info(path)


def test_missing_unreadable_and_huge_files_are_named(tmp_path):
    with pytest.raises(CalibrationError):
        read_camera_info(tmp_path / 'none.yaml')
    with pytest.raises(CalibrationError):
        read_camera_info(tmp_path)
    huge = tmp_path / 'huge.yaml'
    with huge.open('wb') as file:
        os.truncate(file.fileno(), 1 << 30)
    with pytest.raises(CalibrationError):
        read_camera_info(huge)


def test_writing_makes_folders_and_replaces_whole_files(tmp_path):
    path = tmp_path / 'a' / 'b' / 'camera.yaml'
    write_camera_info(path, calibration(name='first'))
    write_camera_info(path, calibration(name='second'))
    assert read_camera_info(path).name == 'second'
    assert [each.name for each in path.parent.iterdir()] == ['camera.yaml']


def test_other_files_are_not_replaced(tmp_path):
    path = tmp_path / 'notes.yaml'
    path.write_text('mine: 1\n')
    with pytest.raises(CalibrationError):
        write_camera_info(path, calibration())
    assert path.read_text() == 'mine: 1\n'


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(FileError):
        write_camera_info(tmp_path / 'file' / 'camera.yaml', calibration())

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parameter schema."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from mixtac_core.node.parameters import (
    ParameterError,
    build,
    fixed,
    parameter,
    parameter_file,
    specs,
)


@dataclass(frozen=True)
class Example:
    """One parameter of each type.

    Attributes:
        device: What to open: the name of a camera,
            or of a virtual one.
        exposure: Exposure

    Raises:
        enabled: Not a description.
    """

    device: str = parameter('davis346', choices=('davis346', 'virtual'))
    exposure: int = parameter(5000, unit='us', within=(0, 1_000_000))
    interval: float = parameter(1e-3, description='Packet length', unit='s', within=(1e-4, 0.1))
    enabled: bool = fixed(True)


@dataclass(frozen=True)
class Longer(Example):
    """One parameter described anew.

    Attributes:
        exposure: Exposure time
    """

    exposure: int = parameter(7000)


def test_descriptions_are_those_of_the_docstrings():
    found = specs(Longer)
    assert [spec.name for spec in found if spec.read_only] == ['enabled']
    texts = {spec.name: spec.description for spec in found}
    assert texts == {
        'device': 'What to open: the name of a camera, or of a virtual one.',
        'exposure': 'Exposure time',
        'interval': 'Packet length',
        'enabled': '',
    }


def test_values_are_checked_and_absent_ones_have_their_defaults():
    assert build(Example, {}) == Example('davis346', 5000, 1e-3, True)
    assert build(Example, {'exposure': 1_000_000, 'interval': 0.1}).exposure == 1_000_000
    assert build(Anything, {'number': 2}).number == 2.0
    assert isinstance(build(Anything, {'number': 2}).number, float)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('exposure', -1),
        ('exposure', 1_000_001),
        ('exposure', 1.5),
        ('exposure', True),
        ('exposure', 'long'),
        ('enabled', 1),
        ('device', 3),
        ('device', 'gelsight'),
        ('interval', float('nan')),
        ('interval', float('inf')),
        ('interval', None),
    ],
)
def test_wrong_values_are_refused_by_name(name: str, value: object):
    with pytest.raises(ParameterError) as caught:
        build(Example, {name: value})
    assert name in str(caught.value)


@dataclass(frozen=True)
class Anything:
    """Parameters without limits."""

    text: str = parameter('')
    number: float = parameter(0.0)
    count: int = parameter(0)
    enabled: bool = parameter(False)


@given(
    st.builds(
        Anything,
        st.text(st.characters(exclude_categories=('Cs',))),
        st.floats(allow_nan=False, allow_infinity=False),
        st.integers(-(2**63), 2**63 - 1),
        st.booleans(),
    )
)
@example(Anything("it's\n: {}", 3e-08))
def test_a_parameter_file_holds_the_same_values(values):
    content = yaml.safe_load(parameter_file('driver', values))
    assert build(Anything, content['/**/driver']['ros__parameters']) == values


@pytest.mark.dds
@pytest.mark.usefixtures('ros_domain')
@pytest.mark.parametrize('serial', ['00000389', '12345e67', 'true', '', "it's", 'a\nb'])
def test_ros_reads_strings_of_a_parameter_file_as_strings(serial, tmp_path):
    rclpy = pytest.importorskip('rclpy')
    path, context = tmp_path / 'saved.yaml', rclpy.Context()
    path.write_text(parameter_file('driver', Anything(serial, 3e-08)))
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    node = rclpy.create_node('driver', context=context)
    try:
        assert node.declare_parameter('text', '').value == serial
        assert node.declare_parameter('number', 0.0).value == 3e-08
    finally:
        node.destroy_node()
        context.shutdown()


def test_an_unknown_name_gives_the_nearest_known_one():
    with pytest.raises(ParameterError) as caught:
        build(Example, {'exposre': 1})
    assert 'exposure' in caught.value.remedy

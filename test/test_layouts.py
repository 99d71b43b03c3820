# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz, PlotJuggler and Foxglove name topics, types and fields that exist."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.topics import TOPICS, message_class

CONFIG = Path(__file__).resolve().parents[1] / 'config'
TYPES = {each.resolved('mixtac'): each.type_name for each in TOPICS}
RVIZ_TYPES = {
    'rviz_default_plugins/Image': 'sensor_msgs/msg/Image',
    'rviz_default_plugins/Wrench': 'geometry_msgs/msg/WrenchStamped',
}
FOXGLOVE_TYPES = {
    'Image': 'sensor_msgs/msg/Image',
    'DiagnosticSummary': 'diagnostic_msgs/msg/DiagnosticArray',
}


def assert_number(topic: str, fields: list[str]) -> None:
    """Walk down a message of the topic's type to a number."""
    assert topic in TYPES, f'{topic} is no topic of the graph'
    value = message_class(TYPES[topic])()
    for field in fields:
        assert hasattr(value, field), f'{topic} has no field {".".join(fields)}'
        value = getattr(value, field)
    assert isinstance(value, (int, float))


def split_at_topic(path: str) -> tuple[str, list[str]]:
    """Return the longest topic that a PlotJuggler path starts with, and the fields below."""
    topic = max((each for each in TYPES if path.startswith(each + '/')), key=len, default='')
    assert topic, f'{path} lies below no topic of the graph'
    return topic, path[len(topic) + 1 :].split('/')


def test_rviz_shows_topics_with_the_right_display_and_a_matching_qos():
    layout = yaml.safe_load((CONFIG / 'rviz' / 'mixtac.rviz').read_text())
    displays = [d for d in layout['Visualization Manager']['Displays'] if 'Topic' in d]
    assert len(displays) >= 3
    reliable = {each.resolved('mixtac'): each.reliable for each in TOPICS}
    for display in displays:
        topic = display['Topic']['Value']
        assert TYPES[topic] == RVIZ_TYPES[display['Class']]
        if not reliable[topic]:
            assert display['Topic']['Reliability Policy'] == 'Best Effort'


def test_plotjuggler_plots_numbers_of_the_topics_it_subscribes():
    root = ET.parse(CONFIG / 'plotjuggler' / 'mixtac.xml').getroot()
    subscribed = {each.get('name'): each.get('type') for each in root.iter('topic')}
    for name, kind in subscribed.items():
        assert TYPES[name] == kind
    curves = [each.get('name') for each in root.iter('curve')]
    assert len(curves) >= 5
    for curve in curves:
        topic, fields = split_at_topic(curve)
        assert topic in subscribed
        assert_number(topic, fields)


def test_foxglove_panels_read_what_exists():
    layout = json.loads((CONFIG / 'foxglove' / 'mixtac.json').read_text())
    panels = layout['configById']
    for name, settings in panels.items():
        for path in settings.get('paths', ()):
            topic, *fields = path['value'].split('.')
            assert_number(topic, fields)
        named = [
            settings.get('topicToRender'),
            settings.get('topicPath'),
            settings.get('imageMode', {}).get('imageTopic'),
        ]
        for topic in filter(None, named):
            wanted = FOXGLOVE_TYPES.get(name.partition('!')[0])
            assert wanted in {None, TYPES[topic]}

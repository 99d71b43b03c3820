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


def test_rviz_shows_topics_with_the_right_display_and_a_matching_qos():
    layout = yaml.safe_load((CONFIG / 'rviz' / 'mixtac.rviz').read_text())
    displays = [d for d in layout['Visualization Manager']['Displays'] if 'Topic' in d]
    assert displays
    reliable = {each.resolved('mixtac'): each.reliable for each in TOPICS}
    for display in displays:
        topic, policy = display['Topic']['Value'], display['Topic']['Reliability Policy']
        assert TYPES[topic] == RVIZ_TYPES[display['Class']]
        assert reliable[topic] or policy == 'Best Effort'


def test_plotjuggler_plots_numbers_of_the_topics_it_subscribes():
    root = ET.parse(CONFIG / 'plotjuggler' / 'mixtac.xml').getroot()
    subscribed = {each.get('name'): each.get('type') for each in root.iter('topic')}
    assert subscribed.items() <= TYPES.items()
    for curve in root.iter('curve'):
        path = curve.get('name')
        topic = max((each for each in subscribed if path.startswith(f'{each}/')), key=len)
        assert_number(topic, path[len(topic) + 1 :].split('/'))


def test_foxglove_panels_read_what_exists():
    layout = json.loads((CONFIG / 'foxglove' / 'mixtac.json').read_text())
    for name, settings in layout['configById'].items():
        for path in settings.get('paths', ()):
            topic, *fields = path['value'].split('.')
            assert_number(topic, fields)
        shown = settings | settings.get('imageMode', {})
        for topic in filter(None, map(shown.get, ('topicToRender', 'topicPath', 'imageTopic'))):
            wanted = FOXGLOVE_TYPES.get(name.partition('!')[0])
            assert wanted in {None, TYPES[topic]}

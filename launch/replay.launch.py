# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording in place of a camera: the sensor's graph on it, in recorded time.

The driver plays the recording on the topics of a camera and publishes `/clock` on the recorded
camera clock, once per millisecond of it at most; every node behind it has `use_sim_time`. With
`clock:=false` the nodes stay on the host's clock.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PLAYBACK = {
    'rate': ('1.0', 'Speed: 1 is real time, 0 as fast as the subscribers allow'),
    'start': ('0.0', 'Where to begin [s]'),
    'loop': ('false', 'Begin again at the end'),
    'paused': (
        'false',
        'Begin standing still; the parameter playback_paused of the driver lets it go',
    ),
}
FORWARDED = ('device', 'namespace', 'params_file', 'autostart', 'log_level')
ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        description='The recording: the folder of a bag, or an .mcap, .db3 or .aedat4 file',
    ),
    *(DeclareLaunchArgument(n, default_value=d, description=t) for n, (d, t) in PLAYBACK.items()),
    DeclareLaunchArgument(
        'clock',
        default_value='true',
        choices=['true', 'false'],
        description='Publish /clock and have the nodes follow it',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='mixtac', description='Namespace of all nodes and topics'
    ),
    DeclareLaunchArgument(
        'params_file',
        default_value='',
        description='Parameter file whose values win over the shipped ones',
    ),
    DeclareLaunchArgument(
        'autostart',
        default_value='true',
        choices=['true', 'false'],
        description='Configure and activate the force estimator',
    ),
    DeclareLaunchArgument(
        'log_level', default_value='info', description='Severity from which the nodes log'
    ),
]


def generate_launch_description():
    """Return the launch description of a replay."""
    sensor = PathJoinSubstitution(
        [FindPackageShare('mixtac_bringup'), 'launch', 'sensor.launch.py']
    )
    arguments = {name: LaunchConfiguration(name) for name in FORWARDED}
    arguments |= {f'playback_{name}': LaunchConfiguration(name) for name in PLAYBACK}
    arguments['use_sim_time'] = LaunchConfiguration('clock')
    graph = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(sensor), launch_arguments=arguments.items()
    )
    return LaunchDescription([*ARGUMENTS, graph])

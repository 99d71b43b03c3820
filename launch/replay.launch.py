# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor's graph on a recording instead of a camera, in recorded time.

The driver plays the recording on the topics of a camera and publishes `/clock` on the recorded
camera clock, at most once per recorded millisecond; the estimator follows it (`use_sim_time`).
With `clock:=false` all nodes use the host clock.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from mixtac_core.node.launch_actions import BOOLEAN, shared_arguments

PLAYBACK = {
    'rate': ('1.0', 'Playback speed: 1 is real time, 0 is as fast as the subscribers allow'),
    'start': ('0.0', 'Where to start in the recording [s]'),
    'loop': ('false', 'Start again at the end'),
    'paused': (
        'false',
        'Start paused; setting the parameter playback_paused of the driver to false continues',
    ),
}
SHARED = ('namespace', 'params_file', 'autostart', 'log_level')
ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        description='The recording: the folder of a bag, or an .mcap, .db3 or .aedat4 file',
    ),
    *(DeclareLaunchArgument(n, default_value=d, description=t) for n, (d, t) in PLAYBACK.items()),
    DeclareLaunchArgument(
        'clock',
        default_value='true',
        choices=BOOLEAN,
        description='Publish /clock; the nodes follow it',
    ),
    *shared_arguments(*SHARED),
]


def generate_launch_description():
    """Return the launch description of a replay."""
    sensor = PathJoinSubstitution(
        [FindPackageShare('mixtac_bringup'), 'launch', 'sensor.launch.py']
    )
    arguments = {name: LaunchConfiguration(name) for name in ('device', *SHARED)}
    arguments |= {f'playback_{name}': LaunchConfiguration(name) for name in PLAYBACK}
    arguments['use_sim_time'] = LaunchConfiguration('clock')
    graph = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(sensor), launch_arguments=arguments.items()
    )
    return LaunchDescription([*ARGUMENTS, graph])

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_sim."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_sim'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed', 'world/presets.yaml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='The virtual Mixtac sensor and its virtual USB camera',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'virtual_arm_node = mixtac_sim.virtual_arm_node:main',
            'virtual_grasp_node = mixtac_sim.virtual_grasp_node:main',
            'virtual_sensor_node = mixtac_sim.virtual_sensor_node:main',
        ],
        'mixtac.usb_backends': ['virtual = mixtac_sim.usb.pyusb_backend:open_backend'],
    },
)

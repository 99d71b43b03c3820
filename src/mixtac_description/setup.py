# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_description with its URDF."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'mixtac_description'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/urdf', sorted(map(str, Path('urdf').glob('*.xacro')))),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='URDF of the fingertip',
    license='Apache-2.0',
    entry_points={'console_scripts': ['frames_node = mixtac_description.frames_node:main']},
)

# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_cli."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_cli'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='The mixtac command line',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'mixtac = mixtac_cli.main:main',
            'recorder_node = mixtac_cli.record.recorder_node:main',
            'supervisor_node = mixtac_cli.supervisor_node:main',
            'view_node = mixtac_cli.view.view_node:main',
        ],
    },
)

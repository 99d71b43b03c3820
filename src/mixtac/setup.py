# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac'

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
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='The mixtac command, the Python interface of the sensor, and the live view',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'mixtac = mixtac.__main__:main',
            'supervisor_node = mixtac.supervisor_node:main',
            'view_node = mixtac.view_node:main',
        ],
    },
)

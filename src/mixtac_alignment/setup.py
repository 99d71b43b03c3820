# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_alignment."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_alignment'

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
    description='Aligns the camera clock with the reference clock',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'alignment_node = mixtac_alignment.alignment_node:main',
            'force_error_node = mixtac_alignment.force_error_node:main',
        ],
    },
)

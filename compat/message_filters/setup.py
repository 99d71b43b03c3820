# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs the stand-in for message_filters."""

from setuptools import find_packages, setup

PACKAGE = 'message_filters'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='Stand-in for the parts of message_filters that Mixtac uses',
    license='Apache-2.0',
)

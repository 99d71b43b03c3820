# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_driver."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_driver'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed', 'davis346/biases.csv']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml', 'mixtac_driver/udev/65-mixtac.rules']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='The DAVIS346 event camera: USB, registers, decoder, driver node',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'driver_node = mixtac_driver.node.driver_node:main',
            'frames_node = mixtac_driver.frames_node:main',
        ],
    },
)

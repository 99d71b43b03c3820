# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_fger."""

import sys
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'mixtac_fger'
if not Path('models').is_dir():
    sys.exit('src/mixtac_fger/models is no folder: the symbolic links are lost; clone with git')

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/models', sorted(map(str, Path('models').glob('*.*')))),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='Normal force and contact from frames and events; alignment of a reference',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'fger_node = mixtac_fger.fger_node:main',
            'alignment_node = mixtac_fger.alignment.alignment_node:main',
            'force_error_node = mixtac_fger.alignment.force_error_node:main',
        ],
        'mixtac.estimators': ['fger_small = mixtac_fger.fger_net:FgerEstimator'],
    },
)

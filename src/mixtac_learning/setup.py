# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_learning."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_learning'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed', 'experiments/*.yaml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description="Training and evaluation of Mixtac's force estimators, and the paper's experiments",
    license='Apache-2.0',
    entry_points={
        'mixtac.estimators': ['fger_paper = mixtac_learning.paper.live:PaperEstimator'],
    },
)

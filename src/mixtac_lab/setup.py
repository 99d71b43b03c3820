# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_lab."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_lab'

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
    description='Experiments and benchmarks of Mixtac',
    license='Apache-2.0',
    entry_points={
        'mixtac.commands': [
            'bench.decode = mixtac_lab.bench.decode:decode',
            'bench.fuzz = mixtac_lab.bench.fuzz:fuzz',
            'bench.pipeline = mixtac_lab.bench.pipeline:pipeline',
            'bench.compose = mixtac_lab.bench.force:compose',
            'bench.two-sensors = mixtac_lab.bench.force:two_sensors',
            'bench.recovery = mixtac_lab.bench.recovery:recovery',
            'bench.infer = mixtac_lab.bench.infer:infer',
            'bench.simulate = mixtac_lab.bench.simulate:simulate',
            'bench.align = mixtac_lab.bench.align:align',
            'bench.slip = mixtac_lab.bench.slip:slip',
            *(
                f'experiments.{name} = mixtac_lab.commands:{name}'
                for name in (
                    'vibration',
                    'stability',
                    'inputs',
                    'fusion',
                    'impact',
                    'slip',
                    'model',
                    'comparison',
                )
            ),
            'experiments.all = mixtac_lab.commands:all_experiments',
            'experiments.tones = mixtac_lab.experiments.studies.tones:tones',
            'experiments.grasps = mixtac_lab.experiments.paper.slip:grasps',
            'experiments.difficulty = mixtac_lab.experiments.studies.difficulty:difficulty',
            'experiments.ablation = mixtac_lab.experiments.studies.difficulty:ablation',
            'experiments.models = mixtac_lab.experiments.studies.models:models',
            'experiments.adaptation = mixtac_lab.experiments.studies.models:adaptation',
            'experiments.alignment = mixtac_lab.experiments.studies.alignment:alignment',
        ],
    },
)

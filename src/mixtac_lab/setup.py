# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_lab."""

from setuptools import find_packages, setup

PACKAGE = 'mixtac_lab'
PAPER = f'{PACKAGE}.experiments.paper'
STUDY = f'{PACKAGE}.experiments.studies'
EXPERIMENTS = {
    'vibration': f'{PAPER}.vibration:vibration',
    'stability': f'{PAPER}.forces:stability',
    'inputs': f'{PAPER}.forces:inputs',
    'fusion': f'{PAPER}.forces:fusion',
    'impact': f'{PAPER}.forces:impact',
    'slip': f'{PAPER}.slip:slip',
    'model': f'{PAPER}.model:model',
    'comparison': f'{PAPER}.comparison:comparison',
}
STUDIES = {
    'all': f'{PACKAGE}.experiments.harness:all',
    'tones': f'{PAPER}.vibration:tones',
    'grasps': f'{PAPER}.slip:grasps',
    'difficulty': f'{STUDY}.difficulty:difficulty',
    'ablation': f'{STUDY}.difficulty:ablation',
    'faults': f'{STUDY}.faults:faults',
    'zero': f'{STUDY}.zero:zero',
    'contact-place': f'{STUDY}.contact_place:contact_place',
    'contact': f'{STUDY}.contact:contact',
    'models': f'{STUDY}.models:models',
    'event-path': f'{STUDY}.event_path:event_path',
    'adaptation': f'{STUDY}.adaptation:adaptation',
    'alignment': f'{STUDY}.alignment:alignment',
}
BENCHMARKS = {
    'decode': f'{PACKAGE}.bench.decode:decode',
    'fuzz': f'{PACKAGE}.bench.fuzz:fuzz',
    'fuzz-nodes': f'{PACKAGE}.bench.fuzz_nodes:fuzz_nodes',
    'pipeline': f'{PACKAGE}.bench.pipeline:pipeline',
    'compose': f'{PACKAGE}.bench.pipeline:compose',
    'two-sensors': f'{PACKAGE}.bench.pipeline:two_sensors',
    'recovery': f'{PACKAGE}.bench.recovery:recovery',
    'infer': f'{PACKAGE}.bench.infer:infer',
    'simulate': f'{PACKAGE}.bench.simulate:simulate',
    'align': f'{PACKAGE}.bench.align:align',
    'slip': f'{PACKAGE}.bench.slip:slip',
    'soak': f'{PACKAGE}.bench.soak:soak',
    'starts': f'{PACKAGE}.bench.starts:starts',
    'limits': f'{PACKAGE}.bench.limits:limits',
    'interlock': f'{PACKAGE}.bench.interlock:interlock',
    'realism': f'{PACKAGE}.bench.realism:realism',
}

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed', 'experiments/*.html', 'experiments/*.yaml']},
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
        'mixtac.experiments': [f'{name} = {target}' for name, target in EXPERIMENTS.items()],
        'mixtac.commands': [
            *(f'experiments.{name} = {target}' for name, target in EXPERIMENTS.items()),
            *(f'experiments.{name} = {target}' for name, target in STUDIES.items()),
            *(f'bench.{name} = {target}' for name, target in BENCHMARKS.items()),
        ],
    },
)

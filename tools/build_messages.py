# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Build message packages into a virtual environment that holds ROS 2 as wheels.

The generators of rosidl run in this process, and one library a package holds what they write: C
structures, both type supports for C, and the Python module. C++ is left out, as no node here needs
it. `colcon build` makes the same from the same `.msg` files where ROS is installed, and takes eight
times as long.

Run by the interpreter of the environment: `python tools/build_messages.py FOLDER...`.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from rosidl_adapter import convert_to_idl
from rosidl_generator_type_description import generate_type_hash
from rosidl_parser.definition import IdlContent, IdlLocator
from rosidl_parser.parser import parse_idl_file
from rosidl_pycommon import convert_camel_case_to_lower_case_underscore as snake
from rosidl_pycommon import expand_template

PREFIX = Path(sys.prefix)
SITE = Path(sysconfig.get_paths()['purelib'])
TYPE_SUPPORTS = ('rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c')
ENTRY_POINT = 'rosidl_typesupport_c'
"""Type support that Python modules load; it chooses one of `TYPE_SUPPORTS` at run time."""
TEMPLATES = {
    'rosidl_generator_c': {
        'idl.h.em': '%s.h',
        'idl__description.c.em': 'detail/%s__description.c',
        'idl__functions.c.em': 'detail/%s__functions.c',
        'idl__functions.h.em': 'detail/%s__functions.h',
        'idl__struct.h.em': 'detail/%s__struct.h',
        'idl__type_support.c.em': 'detail/%s__type_support.c',
        'idl__type_support.h.em': 'detail/%s__type_support.h',
    },
    'rosidl_typesupport_fastrtps_c': {
        'idl__rosidl_typesupport_fastrtps_c.h.em': 'detail/%s__rosidl_typesupport_fastrtps_c.h',
        'idl__type_support_c.cpp.em': 'detail/%s__type_support_c.cpp',
    },
    'rosidl_typesupport_introspection_c': {
        'idl__rosidl_typesupport_introspection_c.h.em': (
            'detail/%s__rosidl_typesupport_introspection_c.h'
        ),
        'idl__type_support.c.em': 'detail/%s__type_support.c',
    },
    'rosidl_typesupport_c': {'idl__type_support.cpp.em': '%s__type_support.cpp'},
    'rosidl_generator_py': {'_idl.py.em': '_%s.py', '_idl_support.c.em': '_%s_s.c'},
}
"""Files that each generator writes for one interface, by the template."""
HEADERS = ('rosidl_generator_c', *TYPE_SUPPORTS)
"""Generators whose files include a header that names what a library exports; on Linux, all."""


class Package:
    """One message package that is being built.

    Args:
        source: Folder with `package.xml`, `msg/` and `srv/`.
        work: Empty folder for what is generated.
    """

    def __init__(self, source: Path, work: Path) -> None:
        manifest = ET.parse(source / 'package.xml').getroot()
        self.source = source
        self.work = work
        self.name = manifest.findtext('name', '').strip()
        self.depends = [(each.text or '').strip() for each in manifest.iter('depend')]
        if (source / 'srv').is_dir():
            self.depends.append('service_msgs')
        self.interfaces = [
            path.relative_to(source)
            for kind in ('msg', 'srv')
            for path in sorted((source / kind).glob(f'*.{kind}'))
        ]

    def describe(self) -> dict[Path, IdlContent]:
        """Write IDL files and type descriptions; return the parsed interfaces by IDL path."""
        idl, hashes = self.work / 'idl' / self.name, self.work / 'hash' / self.name
        for each in self.interfaces:
            convert_to_idl(self.source, self.name, each, idl)
        relative = [each.with_suffix('.idl') for each in self.interfaces]
        arguments = {
            'package_name': self.name,
            'output_dir': str(hashes),
            'idl_tuples': [f'{idl}:{each.as_posix()}' for each in relative],
            'include_paths': [
                f'{path.name}:{path}' for path in (PREFIX / 'share').iterdir() if path.is_dir()
            ],
        }
        file = self.work / 'arguments.json'
        file.write_text(json.dumps(arguments))
        generate_type_hash(str(file))
        return {each: parse_idl_file(IdlLocator(idl, each)).content for each in relative}

    def generate(self, contents: dict[Path, IdlContent]) -> None:
        """Write the C, C++ and Python files of all interfaces."""
        for generator, mapping in TEMPLATES.items():
            templates = PREFIX / 'share' / generator / 'resource'
            for path, content in contents.items():
                data = {
                    'package_name': self.name,
                    'interface_path': path,
                    'content': content,
                    'type_description_info': json.loads(
                        (self.work / 'hash' / self.name / path.with_suffix('.json')).read_text()
                    ),
                    'type_source_file': self.source / path.with_suffix(f'.{path.parts[0]}'),
                    'disable_description_codegen': False,
                    'type_supports': TYPE_SUPPORTS,
                }
                for template, pattern in mapping.items():
                    target = self.work / generator / self.name / path.parent
                    target /= pattern % snake(path.stem)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    expand_template(template, data, str(target), template_basepath=templates)
        for generator in HEADERS:
            self._write_visibility(generator)
        self._write_module(contents)

    def _write_visibility(self, generator: str) -> None:
        name = f'{generator}__visibility_control.h'
        folder = self.work / generator / self.name / 'msg'
        folder.mkdir(parents=True, exist_ok=True)
        kinds = ('PUBLIC', 'EXPORT', 'IMPORT')
        lines = [f'#define {generator.upper()}_{kind}_{self.name}' for kind in kinds]
        (folder / name).write_text('#pragma once\n' + '\n'.join(lines) + '\n')

    def _write_module(self, contents: dict[Path, IdlContent]) -> None:
        folder = self.work / 'rosidl_generator_py' / self.name
        (folder / '__init__.py').touch()
        for kind in {path.parts[0] for path in contents}:
            lines = []
            for path in sorted(contents):
                if path.parts[0] == kind:
                    suffixes = ('', '_Event', '_Request', '_Response') if kind == 'srv' else ('',)
                    names = ', '.join(path.stem + each for each in suffixes)
                    lines.append(f'from {self.name}.{kind}._{snake(path.stem)} import {names}\n')
            (folder / kind / '__init__.py').write_text(''.join(lines))
        everything = IdlContent()
        for content in contents.values():
            everything.elements += content.elements
        data = {'package_name': self.name, 'content': everything, 'typesupport_impl': ENTRY_POINT}
        expand_template(
            '_idl_pkg_typesupport_entry_point.c.em',
            data,
            str(folder / f'_{self.name}_s.ep.{ENTRY_POINT}.c'),
            template_basepath=PREFIX / 'share' / 'rosidl_generator_py' / 'resource',
        )

    def compile(self) -> Path:
        """Compile and link everything; return the library."""
        include = [self.work / each for each in TEMPLATES]
        include += [PREFIX / 'include', *(PREFIX / 'include').iterdir()]
        include += [Path(sysconfig.get_paths()['include']), Path(np.get_include())]
        flags = ['-fPIC', '-O1', '-w', '-DFASTCDR_DYN_LINK', f'-DROS_PACKAGE_NAME="{self.name}"']
        flags += [f'-I{path}' for path in include if path.is_dir()]
        sources = [p for p in sorted(self.work.rglob('*')) if p.suffix in {'.c', '.cpp'}]
        objects = [path.with_suffix(path.suffix + '.o') for path in sources]
        compilers = {
            '.c': [*shlex.split(os.environ.get('CC', 'cc')), '-std=gnu11'],
            '.cpp': [*shlex.split(os.environ.get('CXX', 'c++')), '-std=gnu++17'],
        }
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            commands = [
                [*compilers[source.suffix], *flags, '-c', str(source), '-o', str(target)]
                for source, target in zip(sources, objects, strict=True)
            ]
            list(pool.map(_run, commands))
        library = self.work / f'lib{self.name}__rosidl.so'
        lib = PREFIX / 'lib'
        parts = ('rosidl_generator_c', 'rosidl_generator_py', ENTRY_POINT, *TYPE_SUPPORTS)
        needed = [lib / f'lib{name}__{part}.so' for name in self.depends for part in parts]
        needed += [lib / f'lib{part}.so' for part in (ENTRY_POINT, *TYPE_SUPPORTS)]
        needed += [lib / f'lib{name}.so' for name in ('rosidl_runtime_c', 'rcutils', 'fastcdr')]
        needed += [lib / 'librosidl_typesupport_fastrtps_cpp.so', lib / 'librmw.so']
        found = [str(path) for path in needed if path.exists()]
        link = ['-shared', f'-Wl,-rpath,{lib}', '-o', str(library), *map(str, objects), *found]
        _run([*compilers['.cpp'], *link])
        return library

    def install(self, library: Path) -> None:
        """Put library, module and descriptions where ament and Python look for them."""
        target = PREFIX / 'lib' / library.name
        # Running nodes keep the file that they have mapped; overwritten, it would crash them.
        target.unlink(missing_ok=True)
        shutil.copyfile(library, target)
        for each in TYPE_SUPPORTS:
            _link(PREFIX / 'lib' / f'lib{self.name}__{each}.so', target)
        module = SITE / self.name
        shutil.rmtree(module, ignore_errors=True)
        shutil.copytree(
            self.work / 'rosidl_generator_py' / self.name,
            module,
            ignore=shutil.ignore_patterns('*.c', '*.o'),
        )
        _link(module / f'{self.name}_s__{ENTRY_POINT}.so', target)
        share = PREFIX / 'share' / self.name
        shutil.rmtree(share, ignore_errors=True)
        for folder in (self.source, self.work / 'idl' / self.name, self.work / 'hash' / self.name):
            for kind in ('msg', 'srv'):
                if (folder / kind).is_dir():
                    shutil.copytree(folder / kind, share / kind, dirs_exist_ok=True)
        shutil.copyfile(self.source / 'package.xml', share / 'package.xml')
        index = PREFIX / 'share' / 'ament_index' / 'resource_index'
        (index / 'packages' / self.name).touch()
        listed = sorted(p.relative_to(share).as_posix() for p in share.glob('*/*'))
        (index / 'rosidl_interfaces' / self.name).write_text('\n'.join(listed))


def _link(path: Path, target: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to(os.path.relpath(target, path.parent))


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f'$ {shlex.join(command)}\n{done.stderr}')


def main() -> None:
    """Build the packages of the folders given, in this order."""
    for each in sys.argv[1:]:
        with tempfile.TemporaryDirectory() as work:
            package = Package(Path(each).resolve(), Path(work))
            package.generate(package.describe())
            package.install(package.compile())


if __name__ == '__main__':
    main()

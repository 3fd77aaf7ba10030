# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Message packages for tests, built by rosidl's generators from the definitions in this folder.

They have the fields of PX4's and MAVROS's definitions that the planner reads or writes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

HERE, PREFIX = Path(__file__).parent, Path(sys.prefix)
USED = ('builtin_interfaces', 'service_msgs', 'std_msgs')
C, PY = 'rosidl_generator_c', 'rosidl_generator_py'
SUPPORT, FAST = 'rosidl_typesupport_c', 'rosidl_typesupport_fastrtps_c'
SEEN = 'rosidl_typesupport_introspection_c'
RUNTIME = ('rosidl_runtime_c', SUPPORT, FAST, f'{FAST}pp', SEEN, 'fastcdr')


def build(package: str, into: Path) -> None:
    """Generate and compile a package, for Fast DDS alone; ``into`` must then be on the path.

    Raises:
        subprocess.CalledProcessError: it does not compile.
    """
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_support
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    out = into / package
    arguments = _arguments(package, out)
    (into / SEEN / package).mkdir(parents=True, exist_ok=True)
    for library, generate, more in (
        ('rosidl_generator_type_description', generate_type_hash, ()),
        (C, generate_c, ()),
        (FAST, generate_typesupport_fastrtps_c, ()),
        (SEEN, generate_introspection, ()),
        (SUPPORT, generate_support, ([FAST, SEEN],)),
        (PY, generate_py, ([SUPPORT],)),
    ):
        resources, file = PREFIX / 'share' / library / 'resource', out / f'{library}.json'
        here = into / SEEN / package if library == SEEN else out  # its files have the same names
        places = {'template_dir': str(resources), 'output_dir': str(here)}
        file.write_text(json.dumps(arguments | places))
        generate(str(file), *more)
        for header in resources.glob('*visibility_control.h.in'):
            text = header.read_text().replace('@PROJECT_NAME_UPPER@', package.upper())
            (out / 'msg' / header.stem).write_text(text.replace('@PROJECT_NAME@', package))
    _compile(package, into)


def _arguments(package: str, out: Path) -> dict[str, object]:
    """Convert the definitions to IDL; return the arguments of the generators."""
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl

    convert, stems = {'.msg': convert_msg_to_idl, '.srv': convert_srv_to_idl}, []
    for file in sorted((HERE / package).rglob('*.*')):
        relative = file.relative_to(HERE / package)
        convert[file.suffix](HERE / package, package, relative, out / relative.parent)
        stems.append(relative.with_suffix(''))
    return {
        'package_name': package,
        'idl_tuples': [f'{out}:{stem}.idl' for stem in stems],
        'type_description_tuples': [f'{stem}.idl:{out / stem}.json' for stem in stems],
        'include_paths': [f'{name}:{PREFIX / "share" / name}' for name in USED],
        'target_dependencies': [],
    }


def _compile(package: str, into: Path) -> None:
    """Compile the types with their support for Fast DDS, their introspection, and the module.

    The first two are looked up by name, which succeeds once the package has loaded them.
    """
    out, names = into / package, [f'lib{package}__{part}.so' for part in (FAST, SEEN)]
    whole = out / 'whole.cpp'  # each of its sources alone would read the headers of C++ again
    whole.write_text(''.join(f'#include "{each}"\n' for each in sorted(out.rglob('*.cpp'))))
    made = sorted(map(str, (*out.rglob('*.c'), whole)))
    python = [each for each in made if each.endswith('_s.c') or '_s.ep.' in each]
    plain = [each for each in made if each not in python]
    _linked(into, out / names[0], plain, [])
    own = [str(out / names[0])]
    _linked(into, out / names[1], list(map(str, (into / SEEN).rglob(f'{package}/**/*.c'))), own)
    _linked(into, out / f'{package}_s__{SUPPORT}.so', python, own)
    loaded = f'ctypes.CDLL(str(pathlib.Path(__file__).parent / name)) for name in {names}'
    (out / '__init__.py').write_text(f'import ctypes, pathlib\n\nLOADED = [{loaded}]\n')


def _linked(into: Path, library: Path, sources: list[str], own: list[str]) -> None:
    installed = PREFIX / 'include'
    folders = [into, into / SEEN, sysconfig.get_path('include'), np.get_include(), installed]
    folders += installed.iterdir()
    linked = [f'{name}__{part}' for name in USED for part in (C, PY, SUPPORT, FAST, SEEN)]
    command = ['gcc', '-shared', '-fPIC', '-w', *(f'-I{each}' for each in folders), *sources, *own]
    command += [f'-Wl,-soname,{library.name}', '-Wl,-rpath,$ORIGIN', f'-L{PREFIX / "lib"}']
    command += [f'-l{name}' for name in (*linked, *RUNTIME, 'stdc++')]
    subprocess.run([*command, '-o', str(library)], check=True)


if __name__ == '__main__':
    build(sys.argv[1], Path(sys.argv[2]))

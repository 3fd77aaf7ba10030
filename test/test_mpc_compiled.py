# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code: compiled once, cached, dropped when sources change, and without leaks."""

import ast
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from harness import python, run

from orbimpc_ros import Floor, Problem, Solver, State

compiler = pytest.importorskip(
    'orbimpc_ros.mpc.kernels.compiler',
    reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these",
)

MACHINE = {'compiled', 'entry_point', 'generic', 'vectorised'}  # decorators
ONCE = """
    import sys, time
    from pathlib import Path
    from orbimpc_ros.mpc.kernels import entry_point

    @entry_point
    def added(one, other):
        return one + other

    mine, others = map(Path, sys.argv[1:])
    mine.touch()
    while not others.exists():
        time.sleep(0.001)
    added(1.0, 2.0)
    print(sum(added.stats.cache_misses.values()))
"""


def test_processes_that_need_the_same_code_at_once_compile_it_once(tmp_path):
    script = tmp_path / 'once.py'
    script.write_text(textwrap.dedent(ONCE))
    command = [sys.executable, str(script)]
    options = {'cwd': tmp_path, 'stdout': subprocess.PIPE, 'text': True}
    pair = [subprocess.Popen([*command, *names], **options) for names in ('ab', 'ba')]
    assert sorted(each.communicate(timeout=60)[0] for each in pair) == ['0\n', '1\n']


def test_kept_code_is_loaded_without_what_numba_compiles_with():
    script = """
        import sys
        from numba.core.runtime import rtsys
        from orbimpc_ros import Problem, Solver
        Solver(Problem())
        print('scipy.linalg' in sys.modules, rtsys._init)
    """
    python(script)  # fills the cache
    assert python(script).stdout == 'False False\n'


SHARED = """
    from orbimpc_ros.mpc.kernels import compiled, entry_point

    @compiled
    def part(x):
        return x  # MORE

    @entry_point
    def whole(x):
        return part(x) + part(2.0 * x) + part(3.0 * x)

    whole(1.0)
    (made,) = whole.overloads.values()
    every = made.library.get_defined_functions()
    print(*(each.linkage.name for each in every if '4part' in each.name))
"""


def test_parts_are_called_only_by_the_code_that_they_are_linked_into(tmp_path):
    """Other code would call them by name, although the optimiser has changed their arguments."""
    script, longer = tmp_path / 'shared.py', 'x = x * x + 1.0 / (2.0 + x)\n        '
    # Too long to be inlined.
    script.write_text(
        textwrap.dedent(SHARED.replace('return x  # MORE', 200 * longer + 'return x'))
    )
    assert run(sys.executable, str(script)).stdout == 'internal\n'


def test_code_from_other_sources_is_forgotten(tmp_path):
    """Machine code includes functions of other files: a change in one makes all of it stale."""
    source, kept = tmp_path / 'one.py', tmp_path / 'kept'
    kept.mkdir()
    source.write_text('a = 1')

    def left():
        (kept / 'one.f-1.nbi').touch()
        (kept / 'one.f-1.1.nbc').touch()
        compiler._forget_other_sources.__wrapped__(tmp_path, kept)
        return sorted(each.suffix for each in kept.iterdir() if each.suffix != '.sha256')

    assert left() == []
    assert left() == ['.nbc', '.nbi']
    source.write_text('a = 2')
    assert left() == []
    compiler._forget_other_sources.__wrapped__(tmp_path, tmp_path / 'where nobody may write')


def test_machine_code_uses_no_source_with_whose_changes_it_would_not_be_forgotten():
    root = Path(compiler.__file__).parents[1]
    shared = {path for pattern in compiler.SHARED for path in root.glob(pattern)}
    used = set()
    for source in root.rglob('*.py'):
        tree = ast.parse(source.read_text())
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        homes = {each.asname or each.name: node.module for node in imports for each in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and MACHINE & {*names_in(node.decorator_list)}:
                mine = (homes[name] for name in names_in(node.body) if name in homes)
                paths = (root.parents[1].joinpath(*module.split('.')) for module in mine)
                used |= {(source.parent, path) for path in paths if path.is_relative_to(root)}
    outside = {path.with_suffix('.py') for folder, path in used if folder != path.parent}
    outside = {path if path.exists() else path.with_suffix('') / '__init__.py' for path in outside}
    assert root / 'proof/tree.py' in outside
    assert outside <= shared


def names_in(nodes):
    return [n.id for node in nodes for n in ast.walk(node) if isinstance(n, ast.Name)]


COUNTED = """
    import sys
    import numpy as np
    from orbimpc_ros.mpc.kernels import compiled, entry_point

    @compiled
    def first(x):
        return x[-3]

    @entry_point
    def borrowing(x):
        return first(x)

    @entry_point
    def creating(x):
        return first(x) + first(x.copy())

    array = np.arange(1.0, 4.0)
    for called in (borrowing, creating):
        called(array)
        before = sys.getrefcount(array)
        print(called(array), sys.getrefcount(array) - before)
"""


def test_functions_with_and_without_arrays_of_their_own_read_and_give_back_others(tmp_path):
    script = tmp_path / 'counted.py'
    script.write_text(textwrap.dedent(COUNTED))
    assert run(sys.executable, str(script)).stdout == '1.0 0\n2.0 0\n'


@pytest.mark.parametrize(
    'posed',
    [{}, {'floor': Floor('polygon')}, {'floor': Floor('circle')}, {'dimension': 3}],
    ids=['hull', 'polygon', 'circle', 'space'],
)
def test_arrays_that_are_handed_over_are_given_back(posed):
    """Machine code has to balance the reference counts of its arguments."""
    problem = Problem(**posed)
    n, solver = problem.dimension, Solver(problem)
    state, goals = State.at(np.zeros(n), np.eye(n)), np.ones((problem.horizon, n))
    arrays = goals, state.position, state.rotation
    solver.solve(state, goals)
    before = [sys.getrefcount(each) for each in arrays]
    for _ in range(3):
        solver.solve(state, goals)
    assert [sys.getrefcount(each) for each in arrays] == before

# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Mutation testing of the check before publishing and of commands.

    make mutants
    python test/long/mutation.py

mutmut (extra ``mutation``; ``tool.mutmut`` in pyproject.toml names files and tests) changes one
thing at a time. A change that no test notices is a hole in the tests, unless it changes nothing:
then it is listed in ``equivalent.yaml``, with the reason. Exit code 1 where a survivor is not
listed, or where what is listed no longer survives.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).with_name('equivalent.yaml')
DEAD = ('killed', 'timeout', 'caught by type check', 'skipped')


class Mutant(NamedTuple):
    """A change: module and function, the lines that go, the lines that come, without indents."""

    where: str
    was: str
    became: str


def known() -> dict[Mutant, str]:
    """The mutants that are reviewed as equivalent, with the reasons."""
    listed = yaml.safe_load(EQUIVALENT.read_text()) or []
    return {Mutant(e['where'], e['was'], e['became']): e['reason'] for e in listed}


def mutant_of(name: str, shown: str) -> Mutant:
    """The mutant that mutmut calls by a name and shows as a diff."""
    lines = shown.splitlines()
    body = lines[next(i for i, line in enumerate(lines) if line.startswith('@@')) + 1 :]

    def changed(sign: str) -> str:
        return '\n'.join(line[1:].strip() for line in body if line.startswith(sign))

    return Mutant(name.rpartition('__mutmut_')[0], changed('-'), changed('+'))


def mutmut(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, '-m', 'mutmut', *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def survivors() -> dict[str, Mutant]:
    """What the last run left alive, by mutmut's name."""
    lines = (line.strip().rpartition(': ') for line in mutmut('results').splitlines())
    alive = [name for name, colon, status in lines if colon and status not in DEAD]
    return {name: mutant_of(name, mutmut('show', name)) for name in alive}


def review(alive: dict[str, Mutant], listed: dict[Mutant, str]) -> tuple[list[str], list[Mutant]]:
    """The names of survivors that are not listed, and what is listed and did not survive."""
    holes = [name for name, mutant in alive.items() if mutant not in listed]
    return holes, [mutant for mutant in listed if mutant not in alive.values()]


def run(jobs: int, *, resume: bool) -> None:
    # What an earlier run killed stays dead for mutmut, whatever became of the tests since.
    if not resume:
        shutil.rmtree(ROOT / 'mutants', ignore_errors=True)
    words = [sys.executable, '-m', 'mutmut', 'run', '--max-children', str(jobs)]
    subprocess.run(words, cwd=ROOT, check=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--resume', action='store_true', help='go on with an interrupted run')
    parser.add_argument('--review', action='store_true', help='look at the last run again')
    args = parser.parse_args()
    if importlib.util.find_spec('mutmut') is None:
        print("mutmut is not installed: pip install 'mutmut>=3.8'", file=sys.stderr)
        return 2
    if not args.review:
        run(args.jobs, resume=args.resume)
    alive, listed = survivors(), known()
    holes, stale = review(alive, listed)
    for name in holes:
        print(f'\n{name} survives:\n- {alive[name].was}\n+ {alive[name].became}')
    for mutant in stale:
        print(f'\nlisted in {EQUIVALENT.name}, yet it does not survive: {mutant}')
    print(f'\n{len(alive)} survive, {len(alive) - len(holes)} of them listed as equivalent')
    return 1 if holes or stale else 0


if __name__ == '__main__':
    sys.exit(main())

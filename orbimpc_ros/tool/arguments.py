# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The commands and their arguments; a command's ``run`` is called with them, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Argument(NamedTuple):
    """An argument as argparse takes it."""

    names: tuple[str, ...]
    options: dict[str, Any]


def _argument(*names: str, **options: Any) -> Argument:
    return Argument(names, options)


def _namespace(word: str) -> str:
    name = word.strip('/')
    return f'/{name}' if name else ''


def _seconds(word: str) -> float:
    seconds = float(word)
    if not 0.0 < seconds < math.inf:
        raise ValueError
    return seconds


def _set(what: str) -> Argument:
    how: Any = {'action': 'append', 'default': [], 'metavar': 'NAME=VALUE'}
    return _argument('--set', dest='changes', help=f'{what}; may be repeated', **how)


ALONE = (
    *('retrieval', 'retrieval3d', 'dubins', 'spacecraft', 'fixed_wing', 'cessna', 'rope'),
    *('servicer', 'multirotor', 'lander'),
)
FLEETS = {'fleet': 4, 'crossing': 8}  # scenario: how many vehicles
SCENARIOS = (*ALONE, *FLEETS)
PROJECTIONS = ('nearest', 'thrust_aligned')
WHICH = 'a parameter file, a study file, or the name of one'
OTHERS = 'separated by commas; all but orbitope need a clone of the repository'
WHOSE = 'of the vehicle, such as uav1'
NAMESPACE = _argument('--namespace', type=_namespace, default='', metavar='NS', help=WHOSE)
COMMANDS = {
    'bench': 'measure side by side with the solvers that are installed',
    'demo': 'run planner and simulator over DDS, record a bag, draw the picture',
    'replay': 'solve the inputs of a bag again, compare',
    'faults': 'try planner and simulator under faults, as real processes, and print the matrix',
    'plot': 'draw the figures and an animation of a bag',
    'solve': 'solve one problem from a file, print the plan',
    'study': 'fly many random tasks and report how they end',
    'verify': 'prove lower bounds again, in exact arithmetic',
    'view': 'look at a flight in a browser, live or from a bag',
}
# Those of the commands that are in benchmarks/, which is not installed, are declared there.
ARGUMENTS: Mapping[str, Sequence[Argument]] = {
    'demo': (
        _argument('scenario', nargs='?', default='retrieval', choices=SCENARIOS, metavar='SCENARIO',
            help=f'one of {", ".join(SCENARIOS)} (default: %(default)s)'),
        _argument('--vehicles', type=int, metavar='K',
            help='size of the fleet (default: 4) or crossing (8)'),
        _argument('--out', default='out', metavar='DIR',
            help='takes the results (default: %(default)s)'),
        _set('override a parameter of planner or simulator'),
    ),
    'replay': (
        _argument('bag', metavar='BAG', help='its folder, .mcap or .db3 file'),
        _argument('--params', metavar='FILE',
            help='parameters; by default those that the bag was made with'),
        _set('override a parameter: what if?'),
        _argument('--tick', type=int, metavar='K',
            help='show this tick alone, recorded and replayed'),
        NAMESPACE,
    ),
    'plot': (
        _argument('bag', metavar='BAG', help='a recorded flight'),
        _argument('-o', '--out', required=True, metavar='DIR',
            help='takes the pictures; made if missing'),
        NAMESPACE,
        _argument('--dark', action='store_true', help='for dark pages, not for print'),
        _argument('--no-animation', dest='animated', action='store_false',
            help='only still pictures'),
    ),
    'solve': (
        _argument('file', metavar='FILE|-', help='the problem, JSON or YAML; - reads stdin'),
        _argument('--projection', choices=PROJECTIONS, default='thrust_aligned',
            help='how rotations are made of points of the orbitope (default: %(default)s)'),
        _argument('--json', dest='as_json', action='store_true',
            help='print JSON with all digits, as where the output is no terminal'),
        _argument('--time-limit', type=_seconds, default=30.0, metavar='SECONDS',
            help='search no longer, and print the best plan found by then (default: %(default)g)'),
        _argument('--certificate', metavar='FILE', help='write what proves the lower bound, or '
            'that nothing is feasible, for `orbimpc verify`'),
    ),
    'study': (
        _argument('file', metavar='FILE', nargs='?', default='retrieval',
            help=f'{WHICH} (default: %(default)s)'),
        _argument('--runs', type=int, default=100, metavar='N',
            help='flights (default: %(default)s)'),
        _argument('--seed', type=int, default=0, metavar='N',
            help='of everything drawn (default: 0)'),
        _argument('--controllers', default='orbitope', metavar='LIST', help=OTHERS),
        _set('a parameter that is not drawn'),
        _argument('-o', '--out', metavar='DIR',
            help='takes the results (default: a new one in out/)'),
        _argument('--resume', action='store_true', help='go on with the study in DIR'),
        _argument('--cluster', metavar='ADDRESS',
            help='of a Dask scheduler (default: the cores here)'),
        _argument('--workers', type=int, metavar='N',
            help='processes here (default: one per core)'),
    ),
    'verify': (
        _argument('path', metavar='CERTIFICATE.json|BAG', help='of `orbimpc solve`; a flight'),
        _argument('--problem', metavar='FILE',
            help='that the certificate is to be of, as given to solve'),
        _argument('--tick', type=int, metavar='K', help='of a bag: this tick alone'),
        NAMESPACE,
        _argument('--params', metavar='FILE', help='of a bag that has no notes of its own'),
        _argument('--out', metavar='DIR', help="write the ticks' certificates there"),
    ),
    'view': (
        _argument('bag', nargs='?', metavar='BAG',
            help='a recorded flight (default: what is running now)'),
        NAMESPACE,
        _argument('--port', type=int, metavar='N',
            help='of the page (default: 9090, or any that is free)'),
        _argument('--no-browser', dest='browser', action='store_false',
            help='only say where the page is'),
    ),
}  # fmt: skip

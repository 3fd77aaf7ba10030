# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The ``orbimpc`` command line: arguments, error lines and exit codes of its commands."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NoReturn

from orbimpc_ros import __version__
from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError
from orbimpc_ros.ros.entry import in_a_line, report_compilation, without_compiler
from orbimpc_ros.tool.files import in_clone, why

DONE, FAILED, BAD_INPUT, INFEASIBLE = 0, 1, 2, 3
CODES: dict[type[OrbimpcError], int] = {BadInput: BAD_INPUT, Infeasible: INFEASIBLE}
INTERRUPTED = 130  # 128 + SIGINT, as shells have it
EXIT_CODES = 'exit codes: 0 done, 1 failed or different, 2 bad input, 3 infeasible, 130 interrupted'

IN_CLONE = ('bench', 'faults')  # in benchmarks/, which is not installed
PLANNING = ('bench', 'demo', 'study')  # long runs, which report a missing compiler
SOLVING = ('bench', 'replay', 'solve', 'study', 'verify')  # in this process: may compile first
Argument = tuple[tuple[str, ...], dict[str, Any]]  # of ``add_argument``: names and options


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other error of the tool."""

    def error(self, message: str) -> NoReturn:
        """Complain and exit."""
        _complain(f'{message} (see {self.prog} --help)')
        sys.exit(BAD_INPUT)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        options = vars(_parser(arguments).parse_args(arguments))
        command = options.pop('command')
        module = _module(command)
        _report_on_machine_code(command)
        code: int = module.run(**options)
        print(end='', flush=True)  # to nowhere if output is closed
        return code
    except OrbimpcError as error:
        _complain(str(error))
        return CODES.get(type(error), FAILED)
    except ImportError as error:
        _complain(in_a_line(error))
        return BAD_INPUT
    except KeyboardInterrupt:
        _complain('interrupted')
        return INTERRUPTED
    except BrokenPipeError:
        # The reader has closed the pipe, as in `orbimpc solve x | head`.
        _end_output()
        return FAILED
    except OSError as error:  # such as a full disk
        _complain(f'{error.filename or "output"}: {why(error)}')
        _end_output()
        return FAILED


def _report_on_machine_code(command: str) -> None:
    """Report a missing compiler or, on a terminal, the progress of compilation."""
    if find_spec('numba') is None:
        if command in PLANNING:
            _complain(without_compiler())
    elif command in SOLVING and sys.stderr.isatty():
        report_compilation(_complain)


def _end_output() -> None:
    """Discard unread output: Python would flush it again at exit and print an error."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; import no command but a called one of benchmarks/."""
    parser = OneLineParser(
        prog='orbimpc',
        description='Convex model predictive control on rotation orbitopes.',
        epilog=EXIT_CODES,
    )
    parser.add_argument('--version', action='version', version=f'orbimpc_ros {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, (summary, arguments) in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary, epilog=EXIT_CODES)
        for names, options in arguments:
            sub.add_argument(*names, **options)
        if name in IN_CLONE and argv[:1] == [name]:
            _module(name).add_arguments(sub)
    return parser


def _module(command: str) -> ModuleType:
    if command in IN_CLONE:
        return in_clone(command, f'orbimpc {command}')
    return import_module(f'orbimpc_ros.tool.{command}')


def _complain(message: str) -> None:
    """Print a message to stderr as one line of printable characters."""
    line = ' '.join(message.split())
    print('orbimpc: ' + ''.join(c if c.isprintable() else '?' for c in line), file=sys.stderr)


# --- arguments, which are passed to a command's ``run`` by name


def _argument(*names: str, **options: Any) -> Argument:
    return names, options


def _namespace(word: str) -> str:
    name = word.strip('/')
    return f'/{name}' if name else ''


def _set(what: str) -> Argument:
    how: Any = {'action': 'append', 'default': [], 'metavar': 'NAME=VALUE'}
    return _argument('--set', dest='changes', help=f'{what}; may be repeated', **how)


SCENARIOS = (
    *('retrieval', 'retrieval3d', 'dubins', 'spacecraft', 'fixed_wing', 'cessna', 'rope'),
    *('servicer', 'multirotor', 'lander', 'fleet', 'crossing'),
)
OTHERS = 'separated by commas; all but orbitope need a clone of the repository'
WHOSE = 'of the vehicle, such as uav1'
PARAMS = _argument('--params', metavar='FILE', help='parameters of a bag that notes none')
NAMESPACE = _argument('--namespace', type=_namespace, default='', metavar='NS', help=WHOSE)
# Summary and arguments of each command; the commands in benchmarks/ declare their own arguments.
COMMANDS: dict[str, tuple[str, tuple[Argument, ...]]] = {
    'bench': ('compare with other solvers that are installed', ()),
    'demo': ('run planner and simulator over DDS, record a bag, draw the picture', (
        _argument('scenario', nargs='?', default='retrieval', choices=SCENARIOS, metavar='SCENARIO',
            help=f'one of {", ".join(SCENARIOS)} (default: %(default)s)'),
        _argument('--vehicles', type=int, metavar='K',
            help='size of the fleet (default: 4) or crossing (8)'),
        _argument('--out', default='out', metavar='DIR',
            help='folder for the results (default: %(default)s)'),
        _set('override a parameter of planner or simulator'),
    )),
    'replay': ('solve the inputs of a bag again and compare', (
        _argument('bag', metavar='BAG', help='its folder, .mcap or .db3 file'),
        _argument('--params', metavar='FILE',
            help='parameter file (default: parameters noted in the bag)'),
        _set('override a parameter'),
        _argument('--tick', type=int, metavar='K',
            help='show only this tick, recorded and replayed'),
        NAMESPACE,
    )),
    'faults': ('run planner and simulator under faults, as real processes, and print the matrix',
        ()),
    'plot': ('draw the figures and an animation of a bag', (
        _argument('bag', metavar='BAG', help='a recorded flight'),
        _argument('-o', '--out', required=True, metavar='DIR',
            help='folder for the pictures'),
        NAMESPACE,
        PARAMS,
        _argument('--dark', action='store_true', help='for dark pages, not for print'),
        _argument('--no-animation', dest='animated', action='store_false',
            help='only still pictures'),
    )),
    'solve': ('solve one problem from a file, print the plan', (
        _argument('file', metavar='FILE|-', help='the problem, JSON or YAML; - reads stdin'),
        _argument('--projection', choices=('nearest', 'thrust_aligned'), default='thrust_aligned',
            help='projection of orbitope points to rotations (default: %(default)s)'),
        _argument('--json', dest='as_json', action='store_true',
            help='print JSON with all digits (default unless on a terminal)'),
        _argument('--time-limit', type=float, default=30.0, metavar='SECONDS',
            help='time limit, at which the best plan found is printed (default: %(default)g)'),
        _argument('--certificate', metavar='FILE', help='write a proof of the lower bound, or '
            'of infeasibility, for `orbimpc verify`'),
    )),
    'study': ('fly many random tasks and report how they end', (
        _argument('file', metavar='FILE', nargs='?', default='retrieval',
            help='a parameter file, a study file, or the name of one (default: %(default)s)'),
        _argument('--runs', type=int, default=100, metavar='N',
            help='number of flights (default: %(default)s)'),
        _argument('--seed', type=int, default=0, metavar='N',
            help='seed of the draws (default: 0)'),
        _argument('--controllers', default='orbitope', metavar='LIST', help=OTHERS),
        _set('set a parameter that is not drawn'),
        _argument('-o', '--out', metavar='DIR',
            help='folder for the results (default: a new one in out/)'),
        _argument('--resume', action='store_true', help='continue the study in DIR'),
        _argument('--cluster', metavar='ADDRESS',
            help='Dask scheduler to use (default: local processes)'),
        _argument('--workers', type=int, metavar='N',
            help='local processes (default: one per core)'),
    )),
    'verify': ('prove lower bounds again in exact arithmetic', (
        _argument('path', metavar='CERTIFICATE.json|BAG', help='from `orbimpc solve`, or a bag'),
        _argument('--problem', metavar='FILE',
            help='problem that the certificate must be for'),
        _argument('--tick', type=int, metavar='K', help='verify only this tick of a bag'),
        NAMESPACE,
        PARAMS,
        _argument('--out', metavar='DIR', help="folder for the ticks' certificates"),
    )),
    'view': ('look at a flight in a browser, live or from a bag', (
        _argument('bag', nargs='?', metavar='BAG',
            help='a recorded flight (default: what is running now)'),
        NAMESPACE,
        _argument('--port', type=int, metavar='N',
            help='port of the page (default: 9090, or any free one)'),
        _argument('--no-browser', dest='browser', action='store_false',
            help='only print the address of the page'),
    )),
}  # fmt: skip

if __name__ == '__main__':
    sys.exit(main())

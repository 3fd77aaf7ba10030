# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc``: error lines and exit codes of its commands, each a module with a ``run``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from orbimpc_ros import __version__
from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError
from orbimpc_ros.ros.entry import in_a_line
from orbimpc_ros.tool.arguments import ARGUMENTS, COMMANDS
from orbimpc_ros.tool.files import why

DONE, FAILED, BAD_INPUT, INFEASIBLE = 0, 1, 2, 3
INTERRUPTED = 130  # 128 + SIGINT, as shells have it
EXIT_CODES = 'exit codes: 0 done, 1 failed or different, 2 bad input, 3 infeasible, 130 interrupted'

IN_CLONE = ('bench', 'faults')  # in benchmarks/, which is not installed
PLANNING = ('bench', 'demo', 'study')  # for long: a slow planner is worth a word
SOLVING = ('bench', 'replay', 'solve', 'study', 'verify')  # in this process, after compiling
CLONE = Path(__file__).resolve().parents[2]


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other error of the tool."""

    def error(self, message: str) -> NoReturn:
        """Complain and exit."""
        _complain(f'{message} (see {self.prog} --help)')
        sys.exit(BAD_INPUT)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        given = vars(_parser(words).parse_args(words))
        command = given.pop('command')
        module = _module(command)
        _report_on_machine_code(command)
        code: int = module.run(**given)
        sys.stdout.flush()
        return code
    except OrbimpcError as error:
        _complain(str(error))
        return _code(error)
    except ModuleNotFoundError as error:
        line = in_a_line(error)
        if not line:
            raise
        _complain(line)
        return BAD_INPUT
    except KeyboardInterrupt:
        _complain('interrupted')
        return INTERRUPTED
    except BrokenPipeError:
        # The reader has left, as in `orbimpc solve x | head`: nothing is left to say to it.
        _end_output()
        return FAILED
    except OSError as error:  # such as a disk that is full
        _complain(f'{error.filename or "output"}: {why(error)}')
        _end_output()
        return FAILED


def _report_on_machine_code(command: str) -> None:
    """Report that there is no compiler, or on a terminal how far it is."""
    from orbimpc_ros.ros.entry import report_compilation, without_compiler

    if find_spec('numba') is None:
        if command in PLANNING:
            _complain(without_compiler())
    elif command in SOLVING and sys.stderr.isatty():
        report_compilation(_complain)


def _end_output() -> None:
    """Drop what nobody takes: Python would try once more at its end, and complain."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; no command is imported but one of the clone that is asked for."""
    parser = OneLineParser(
        prog='orbimpc',
        description='Convex model predictive control on rotation orbitopes.',
        epilog=EXIT_CODES,
    )
    parser.add_argument('--version', action='version', version=f'orbimpc_ros {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, summary in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary, epilog=EXIT_CODES)
        for names, options in ARGUMENTS.get(name, ()):
            sub.add_argument(*names, **options)
        if name in IN_CLONE and words[:1] == [name]:
            _module(name).add_arguments(sub)
    return parser


def _module(command: str) -> ModuleType:
    if command not in IN_CLONE:
        return import_module(f'orbimpc_ros.tool.{command}')
    if not (CLONE / 'benchmarks' / '__init__.py').is_file():
        raise BadInput.stating(f'orbimpc {command}', 'not installed', 'run it from a clone')
    if str(CLONE) not in sys.path:
        sys.path.append(str(CLONE))
        known = os.environ.get('PYTHONPATH')  # for the processes that it starts
        os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, (str(CLONE), known)))
    return import_module(f'benchmarks.{command}')


def _code(error: OrbimpcError) -> int:
    if isinstance(error, BadInput):
        return BAD_INPUT
    return INFEASIBLE if isinstance(error, Infeasible) else FAILED


def _complain(message: str) -> None:
    """Print one line to stderr, whatever a file has put into the message."""
    line = ' '.join(message.split())
    print('orbimpc: ' + ''.join(c if c.isprintable() else '?' for c in line), file=sys.stderr)


if __name__ == '__main__':
    sys.exit(main())

# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node as a process: start, signals, guarded callbacks, a last safe command, exit codes."""

from __future__ import annotations

import ast
import faulthandler
import functools
import gc
import os
import shlex
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import dropwhile, pairwise
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_default_context, remove_ros_args

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason

DONE, FAILED, BAD_INPUT = 0, 1, 2
FAILURES_IN_A_ROW = 5  # of one callback, after which the node gives up
FAREWELLS = 3  # safe commands on the way out
ACKNOWLEDGED = 1.0  # [s] the last messages have to arrive
LIFE = 0.1  # [s] DDS gives signs of life of a planner so often, for who watches for them
SPIN = 0.05  # [s] a signal waits at most this long
LAST_RESORT = 30.0  # [s] after which a process that was to end, and hangs, is ended
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
CLOSED = ('LOCALHOST', 'OFF')  # ranges that keep other machines out
SECURITY = 'ROS_SECURITY_ENABLE'
KNOWN_WORDS = 'arguments of ROS, such as --params-file FILE, -p NAME:=VALUE, -r FROM:=TO'


def qos(
    depth: int = 1,
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
    lease: float = 0.0,
) -> QoSProfile:
    """Return a quality of service that keeps the last ``depth`` messages.

    With a ``lease`` [s], DDS gives or expects signs of life of the process so often.
    """
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=reliability,
        durability=durability,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(nanoseconds=round(1e9 * lease)),
    )


@contextmanager
def initialised(
    words: Sequence[str] = (), *, domain: int | None = None, context: Context | None = None
) -> Iterator[Context]:
    """Keep rclpy started as long as the block lasts; signals are left to the caller.

    Args:
        words: a command line with arguments of ROS.
        domain: of DDS; by default the environment's.
        context: to start; by default a new one, so that several can be there.
    """
    context = context or Context()
    signals = SignalHandlerOptions.NO
    rclpy.init(args=list(words), context=context, domain_id=domain, signal_handler_options=signals)
    try:
        yield context
    finally:
        context.try_shutdown()


@contextmanager
def attached(
    name: str, *, domain: int | None = None, executor: str = 'wait_set', **options: Any
) -> Iterator[tuple[Node, Executor]]:
    """Yield a node of a context of its own, and its executor: for what is not a process of ROS.

    Args:
        name: of the node.
        domain: of DDS; by default the environment's.
        executor: as :func:`executor_named` knows it.
        options: of ``rclpy.create_node``.
    """
    with initialised(domain=domain) as context:
        node = rclpy.create_node(name, context=context, **options)
        spinning = executor_named(executor, context)
        spinning.add_node(node)
        try:
            yield node, spinning
        finally:
            spinning.shutdown()
            node.destroy_node()


class Guarded(Node):
    """A node none of whose callbacks can end it, and that ends well.

    Attributes:
        kind: what it is called unless it is renamed.
        exit_code: the process ends with it as soon as it is not None.
        steady: a clock that neither jumps nor stops, for everything that watches.
        failures: callbacks that have failed so far.
        active: whether it works; callbacks made by :meth:`at_work` do nothing otherwise.
    """

    def __init__(self, name: str, parameters: Sequence[Parameter] = ()) -> None:
        try:
            super().__init__(name, parameter_overrides=list(parameters))
        except InvalidParameterTypeException as error:  # of a parameter that every node has
            wrong = next(each for each in self._parameter_overrides if each in str(error))
            given = self._parameter_overrides[wrong].value
            raise BadInput(wrong, given, 'true | false') from None
        self.kind = name
        self.exit_code: int | None = None
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.failures = 0
        self.active = False
        self._in_a_row: Counter[str] = Counter()

    def begin(self) -> None:
        """Begin to work; called once, before the node spins."""

    def safe(self, reason: Reason) -> None:
        """Do what is safe right now; the farewell and every failure call it."""

    def steady_now(self) -> float:
        """Return the time of the steady clock [s]."""
        return time.monotonic()

    def guard(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return the callback, made to report what it raises instead of raising it."""

        @functools.wraps(callback)
        def guarded(*arguments: Any) -> Any:
            try:
                result = callback(*arguments)
            except BaseException as error:
                self.failed(callback.__name__, error)
                # A service has to answer: with the response as it came.
                return arguments[1] if len(arguments) == 2 else None
            self._in_a_row[callback.__name__] = 0
            return result

        return guarded

    def at_work(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return the callback, guarded, and made to do nothing while the node is not active."""

        @functools.wraps(callback)
        def working(*arguments: Any) -> Any:
            return callback(*arguments) if self.active else None

        return self.guard(working)

    def failed(self, what: str, error: BaseException) -> None:
        """Report a failure, do what is safe, and give up after too many in a row.

        A panic in a library written in Rust is no ``Exception``, yet no reason to end at once.

        Raises:
            KeyboardInterrupt, SystemExit: if that is what the error is.
        """
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise error
        reason = f'{what} failed: {type(error).__name__}: {error}'
        self._count(what, reason)
        try:
            self.safe(Reason(Cause.FAILURE, reason))
        except Exception as worse:
            self._count('safe', f'the safe command failed: {type(worse).__name__}: {worse}')

    def _count(self, what: str, reason: str) -> None:
        self.failures += 1
        self._in_a_row[what] += 1
        self.get_logger().error(reason)
        if self._in_a_row[what] >= FAILURES_IN_A_ROW:
            self.get_logger().fatal(f'{what} failed {FAILURES_IN_A_ROW} times in a row: giving up')
            self.exit_code = FAILED

    def every(self, period: float, callback: Callable[[], None]) -> Any:
        """Call back every ``period`` [s] of the steady clock while the node is active."""
        return self.create_timer(period, self.at_work(callback), clock=self.steady)


def run(make: Callable[[], Guarded], argv: Sequence[str] | None = None) -> int:
    """Run a node until it is done or stopped, and return the exit code.

    Args:
        make: creates the node; BadInput from it ends the process with code 2 and one line.
        argv: the command line; by default this process's.
    """
    os.environ.setdefault(RANGE, 'LOCALHOST')
    words = list(sys.argv if argv is None else argv)
    try:
        signals = _Signals()
        _require_files(words)
        with _initialised(words):
            _require_ros_words(words)
            node = _born(make)
            signals.starting = False
            return _live(node, signals)
    except _Stopped:
        return DONE
    except (BadInput, _Unreadable) as error:
        return _ended(error, BAD_INPUT)
    except rclpy_implementation.RCLError as error:  # as where security is asked for and missing
        return _ended(f'the node cannot be created: {error}', FAILED)
    finally:
        _end_within(LAST_RESORT)  # what is left is cleared away by the interpreter's end


def _ended(error: object, code: int) -> int:
    """Print an error in one line, with what security needs where that is on; return the code."""
    line = ' '.join(str(error).split())
    if os.environ.get(SECURITY) == 'true':
        needs = 'ROS_SECURITY_KEYSTORE and a middleware with security'
        line = f'{line} ({SECURITY}=true needs {needs})'
    print(line, file=sys.stderr)
    return code


class _Stopped(KeyboardInterrupt):
    """A signal during the start, when nothing has been commanded yet."""


class _Unreadable(Exception):
    """rclpy cannot read the command line, or a parameter file on it."""


class _Signals:
    """SIGINT and SIGTERM: they break off a start, and from then on are remembered.

    The handlers are installed even where SIGINT is ignored, as by a shell's background jobs: who
    stops a node has to reach it.

    Attributes:
        received: numbers of the signals so far.
        starting: whether one breaks off what is being done.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self.starting = True
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._take)

    def _take(self, number: int, _frame: Any) -> None:
        _end_within(LAST_RESORT)
        self.received.append(number)
        if self.starting and len(self.received) == 1:
            raise _Stopped


def _require_files(words: Sequence[str]) -> None:
    """Refuse a parameter file that is not there: rcl would log of its own parser, too."""
    for flag, word in pairwise(dropwhile('--ros-args'.__ne__, words)):
        if flag == '--params-file' and not Path(word).exists():
            raise BadInput.stating(word, 'no such file', '--params-file is to name one')


@contextmanager
def _initialised(words: Sequence[str]) -> Iterator[None]:
    """Keep rclpy started with the command line as long as the block lasts.

    Raises:
        BadInput, _Unreadable: an unknown argument; a malformed rule or parameter file.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(initialised(words, context=get_default_context()))
        except rclpy_implementation.UnknownROSArgsError as error:
            unknown = ' '.join(ast.literal_eval(str(error)))
            problem, hint = f'unknown argument {unknown}', f'allowed: {KNOWN_WORDS}'
            raise BadInput.stating('command line', problem, hint) from None
        except RuntimeError as error:
            raise _Unreadable(str(error)) from None
        yield


def _require_ros_words(words: Sequence[str]) -> None:
    """Refuse words that nobody would look at."""
    _, *plain = remove_ros_args(args=list(words))
    if plain:
        problem = f'{shlex.join(plain)} is not behind --ros-args'
        hint = f'allowed: --ros-args, then {KNOWN_WORDS}'
        raise BadInput.stating('command line', problem, hint)


def _born(make: Callable[[], Guarded]) -> Guarded:
    """Return a new node that has begun; one whose start fails is destroyed.

    Left over, its publishers would be deleted by the interpreter's end, after the context's.
    """
    with warnings.catch_warnings():
        # What rclpy says about its own clearing away, where it fails.
        warnings.simplefilter('ignore', RuntimeWarning)
        node = make()
        try:
            node.begin()
        except BaseException:
            _end_within(LAST_RESORT)
            with suppress(RuntimeError):  # of rclpy; what has failed before is what to tell
                node.destroy_node()
            raise
        return node


def _live(node: Guarded, signals: _Signals) -> int:
    """Spin a node until it is done or a signal comes, let it take its leave; return its code."""
    _warn_of_range(node)
    executor = executor_named(node.get_parameter('executor').value)
    executor.add_node(node)
    # What the start has made stays: each full collection would look through all of it, for 60 ms.
    gc.freeze()
    gc.enable()
    while not signals.received and node.exit_code is None:
        _spin(node, executor)
    _end_within(LAST_RESORT)
    if signals.received:
        name = signal.Signals(signals.received[0]).name
        node.get_logger().info(f'received {name}, stopping')
    for _ in range(FAREWELLS):
        node.guard(node.safe)(Reason(Cause.SHUTDOWN, 'shutting down'))
    _let_go(node)
    executor.shutdown()
    node.destroy_node()
    return node.exit_code or DONE


def executor_named(name: str, context: Context | None = None) -> Executor:
    """Return a new executor, ``wait_set`` or ``events``; the context is by default rclpy's.

    Raises:
        BadInput: this rclpy has no executor of events.
    """
    if name == 'wait_set':
        return SingleThreadedExecutor(context=context)
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        allowed = 'wait_set: this rclpy is older than 7.1.4'
        raise BadInput('executor', name, allowed) from None
    return EventsExecutor(context=context)


def _end_within(patience: float) -> None:
    """End this process with code 1, and say where it hangs, unless it ends by itself [s].

    The threads of a middleware can block its clearing away for ever (eProsima/Fast-DDS#6502), or
    for minutes (#6513). A timer outside of Python sees to it: it needs no thread that answers.
    """
    faulthandler.dump_traceback_later(patience, exit=True)


def _spin(node: Guarded, executor: Executor) -> None:
    try:
        executor.spin_once(timeout_sec=SPIN)
    except BaseException as error:  # from callbacks of rclpy's own, such as a malformed /clock
        node.failed('spinning', error)


def _let_go(node: Guarded) -> None:
    """Wait until the last messages have arrived, but not for a subscriber that hangs."""
    end = node.steady_now() + ACKNOWLEDGED
    for publisher in node.publishers:
        left = max(0.0, end - node.steady_now())
        publisher.wait_for_all_acked(Duration(seconds=left))


def _warn_of_range(node: Guarded) -> None:
    if os.environ[RANGE] not in CLOSED:
        node.get_logger().warning(f'{RANGE}={os.environ[RANGE]}: open to other machines')
    if os.environ.get(PEERS):
        node.get_logger().warning(f'{PEERS}={os.environ[PEERS]}: open to these machines')

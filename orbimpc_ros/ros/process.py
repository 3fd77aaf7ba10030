# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node as a process: start, signals, a last safe command, exit codes."""

from __future__ import annotations

import ast
import faulthandler
import gc
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import dropwhile, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
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
from orbimpc_ros.ros.entry import BAD_INPUT, DONE, SIGNALS, leave_at_signals

if TYPE_CHECKING:
    from orbimpc_ros.ros.lifecycle import Managed

FAILED = 1  # exit code
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


LATEST = qos(1, ReliabilityPolicy.BEST_EFFORT)
LATCHED = qos(durability=DurabilityPolicy.TRANSIENT_LOCAL)


def full_name(endpoint: Any) -> str:
    """Return the full name of the node that has an endpoint of a topic, as the graph shows it."""
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


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


def run(make: Callable[[], Managed], argv: Sequence[str] | None = None) -> int:
    """Run a node until it is done or stopped, and return the exit code.

    A signal during the start ends the process at once: nothing has been commanded yet.

    Args:
        make: creates the node; BadInput from it ends the process with code 2 and one line.
        argv: the command line; by default this process's.
    """
    os.environ.setdefault(RANGE, 'LOCALHOST')
    words = list(sys.argv if argv is None else argv)
    leave_at_signals()
    try:
        _require_files(words)
        with ExitStack() as stack:
            try:
                stack.enter_context(initialised(words, context=get_default_context()))
            except rclpy_implementation.UnknownROSArgsError as error:
                unknown = f'unknown argument {" ".join(ast.literal_eval(str(error)))}'
                hint = f'allowed: {KNOWN_WORDS}'
                raise BadInput.stating('command line', unknown, hint) from None
            except RuntimeError as error:  # a malformed rule or parameter file
                return _ended(error, BAD_INPUT)
            _require_ros_words(words)
            return _live(_begun(make))
    except BadInput as error:
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


def _require_files(words: Sequence[str]) -> None:
    """Refuse a parameter file that is not there: rcl would log of its own parser, too."""
    for flag, word in pairwise(dropwhile('--ros-args'.__ne__, words)):
        if flag == '--params-file' and not Path(word).exists():
            raise BadInput.stating(word, 'no such file', '--params-file is to name one')


def _require_ros_words(words: Sequence[str]) -> None:
    """Refuse words that nobody would look at."""
    _, *plain = remove_ros_args(args=list(words))
    if plain:
        problem = f'{shlex.join(plain)} is not behind --ros-args'
        hint = f'allowed: --ros-args, then {KNOWN_WORDS}'
        raise BadInput.stating('command line', problem, hint)


def _begun(make: Callable[[], Managed]) -> Managed:
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
            with suppress(RuntimeError):  # of rclpy; what has failed before is what to report
                node.destroy_node()
            raise
        return node


def _live(node: Managed) -> int:
    """Spin a node until it is done or a signal comes, let it take its leave; return its code."""
    received = _signals()
    if os.environ[RANGE] not in CLOSED:
        node.get_logger().warning(f'{RANGE}={os.environ[RANGE]}: open to other machines')
    if os.environ.get(PEERS):
        node.get_logger().warning(f'{PEERS}={os.environ[PEERS]}: open to these machines')
    executor = executor_named(node.get_parameter('executor').value)
    executor.add_node(node)
    # What the start has made stays: each full collection would look through all of it, for 60 ms.
    gc.freeze()
    gc.enable()
    while not received and node.exit_code is None:
        _spin(node, executor)
    _end_within(LAST_RESORT)
    if received:
        node.get_logger().info(f'received {signal.Signals(received[0]).name}, stopping')
    for _ in range(FAREWELLS):
        node.guard(node.safe)(Reason(Cause.SHUTDOWN, 'shutting down'))
    # The last messages have to arrive, but a subscriber that hangs is not waited for.
    end = node.steady_now() + ACKNOWLEDGED
    for publisher in node.publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - node.steady_now())))
    executor.shutdown()
    node.destroy_node()
    return node.exit_code or DONE


def _spin(node: Managed, executor: Executor) -> None:
    try:
        executor.spin_once(timeout_sec=SPIN)
    except BaseException as error:  # from callbacks of rclpy's own, such as a malformed /clock
        node.failed('spinning', error)


def _signals() -> list[int]:
    """Remember SIGINT and SIGTERM from now on; return the list of those received."""
    received: list[int] = []

    def take(number: int, _frame: Any) -> None:
        _end_within(LAST_RESORT)
        received.append(number)

    for number in SIGNALS:
        signal.signal(number, take)
    return received


def _end_within(patience: float) -> None:
    """End this process with code 1, and say where it hangs, unless it ends by itself [s].

    The threads of a middleware can block its clearing away for ever (eProsima/Fast-DDS#6502), or
    for minutes (#6513). A timer outside of Python sees to it: it needs no thread that answers.
    """
    faulthandler.dump_traceback_later(patience, exit=True)

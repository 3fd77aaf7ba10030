# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node as a process: its start, signals, final safe commands, exit codes, and life cycle.

A managed node is configured and shut down by lifecycle transitions; its callbacks cannot end it.
rclpy's own managed node swallows exceptions of transitions, and stops spinning when an impossible
transition is requested: here, both are logged in one line, and the node continues.
"""

from __future__ import annotations

import argparse
import ast
import faulthandler
import functools
import gc
import json
import math
import os
import shlex
import signal
import sys
import textwrap
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from operator import attrgetter
from typing import Any, ClassVar

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn as Ended
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import get_default_context, remove_ros_args

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros.entry import BAD_INPUT, DONE, SIGNALS, leave_at_signals
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters import spec
from orbimpc_ros.ros.parameters.spec import ParameterSpec, Values

ENDPOINTS = ('publisher', 'subscription', 'service', 'client', 'timer')
HELD_UP = 0.05  # [s] between readings of two clocks, above which they are not compared
CLOCK_SET = 0.1  # [s] jump of the system clock that is tolerated
FAILURES_IN_A_ROW = 5  # failures of one callback, after which the node gives up


class Managed(LifecycleNodeMixin, Node):
    """A node with parameters of a table, a life cycle and guarded callbacks.

    A subclass has the table of its parameters, and implements ``configure``, ``activate`` and
    ``safe``. Endpoints created while it is configured are destroyed when that state ends, for
    whatever reason.

    Attributes:
        kind: its name unless it is remapped.
        specs: the table of its parameters, which are checked and changed as a whole.
        forced: parameters that cannot be given.
        settings_of: makes settings of the values of all parameters, or raises BadInput.
        INACTIVE: the reason of the last safe action before it is inactive.
        given: values given at the start, by parameter.
        settings: made of the present values of all parameters.
        exit_code: once not None, the process ends with it.
        steady: a clock that neither jumps nor stops, for all monitoring.
        failures: number of failed callbacks so far.
        configured: whether it is configured, or being configured.
        active: whether it is active; callbacks made by :meth:`at_work` do nothing otherwise.

    Raises:
        BadInput: a parameter is unknown or its value is not allowed.
    """

    kind: ClassVar[str]
    specs: ClassVar[Sequence[ParameterSpec]]
    forced: ClassVar[Sequence[Parameter]] = ()
    settings_of: ClassVar[staticmethod[[Values], Any]]
    INACTIVE: ClassVar[Reason] = Reason(Cause.DISABLED, 'inactive')

    def __init__(self) -> None:
        Node.__init__(self, self.kind, parameter_overrides=list(self.forced))
        self.exit_code: int | None = None
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.failures = 0
        self.active = False
        self._in_a_row: Counter[str] = Counter()
        self.configured = False
        self._error: BaseException | None = None  # of the last transition
        LifecycleNodeMixin.__init__(self)
        self._change: Callable[[Any, Any], Any] = self._service_change_state.callback
        self._service_change_state.callback = self.guard(self._on_change_state)
        overrides = {name: each.value for name, each in self._parameter_overrides.items()}
        # rcl reads [], as dumped for an empty list, as no value.
        self.given = {name: () if value is None else value for name, value in overrides.items()}
        spec.refuse_unknown(self.given, self.specs)
        self._values = spec.completed(self.specs, self.given)
        self._values['use_sim_time'] = self.get_parameter('use_sim_time').value
        self.settings = self.settings_of(self._values)
        rows: Any = [(each.name, self._values[each.name], each.descriptor) for each in self.specs]
        self.declare_parameters('', rows, ignore_override=True)
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._on_changed)
        self._lasting = self._endpoints()  # also while it is unconfigured

    # --- for subclasses to implement

    def install(self) -> None:
        """Work with changed settings."""

    def configure(self) -> None:
        """Create everything needed for work.

        Raises:
            BadInput: the parameters do not allow it; the node stays unconfigured.
        """

    def activate(self) -> None:
        """Start from a fresh state."""

    def safe(self, reason: Reason) -> None:
        """Perform the safe action now: at shutdown, after a failure, before it is inactive."""

    # --- parameters

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        values = self._values | {each.name: each.value for each in changes}
        try:
            if values['use_sim_time'] != self._values['use_sim_time']:
                raise BadInput('use_sim_time', values['use_sim_time'], 'set at the start only')
            self._accepted = values, self.settings_of(values)
        except Exception as error:  # an exception would let remote callers end the node
            return SetParametersResult(successful=False, reason=_said(error))
        return SetParametersResult(successful=True)

    def _on_changed(self, _changes: list[Parameter]) -> None:
        self._values, self.settings = self._accepted
        self.install()

    # --- callbacks

    steady_now = staticmethod(time.monotonic)  # time of the steady clock [s]

    def guard(
        self, callback: Callable[..., Any], *bound: str, at_work: bool = False
    ) -> Callable[..., Any]:
        """Return the callback, wrapped to report exceptions instead of raising them.

        ``bound`` are its first arguments, such as the topic. ``at_work``, it does nothing while the
        node is not active.
        """
        name = ' '.join((callback.__name__.lstrip('_'), *bound))
        called = functools.partial(callback, *bound)

        @functools.wraps(called)  # rclpy inspects the number of arguments
        def guarded(*arguments: Any) -> Any:
            if at_work and not self.active:
                return None
            try:
                result = called(*arguments)
            except BaseException as error:
                self.failed(name, error)
                # A service must answer: with the unchanged response.
                return arguments[1] if len(arguments) == 2 else None
            self._in_a_row[name] = 0
            return result

        return guarded

    at_work = functools.partialmethod(guard, at_work=True)

    def every(self, period: float, callback: Callable[[], None]) -> Any:
        """Call back every ``period`` [s] of the steady clock while the node is active."""
        return self.create_timer(period, self.at_work(callback), clock=self.steady)

    def failed(self, what: str, error: BaseException) -> None:
        """Report a failure, act safely, and give up after too many in a row.

        A panic in a library written in Rust is no ``Exception``, but no reason to end at once.
        """
        reason = f'{what} failed: {type(error).__name__}: {error}'
        self.failures += 1
        self._in_a_row[what] += 1
        self.get_logger().error(reason)
        if self._in_a_row[what] >= FAILURES_IN_A_ROW:
            self.get_logger().fatal(f'{what} failed {FAILURES_IN_A_ROW} times in a row: giving up')
            self.exit_code = FAILED
        if what != 'safe':
            self.guard(self.safe)(Reason(Cause.FAILURE, reason))

    # --- transitions

    def begin(self) -> None:
        """Configure and activate the node, unless a lifecycle manager will do so.

        Raises:
            BaseException: any error of these transitions.
        """
        if not self.settings.autostart:
            self.get_logger().info('unconfigured: waits for ~/change_state')
            return
        self._error = None
        try:
            self.trigger_configure()
            if self._error is None:
                self.trigger_activate()
        finally:  # rclpy may also have failed to publish the transition
            if self._error is not None:
                raise self._error

    def on_configure(self, state: LifecycleState) -> Ended:
        """Configure the node, or clean up after a failure."""
        self.configured = True
        result = self._tried(self.configure)
        if result != Ended.SUCCESS:
            self.on_cleanup(state)
        return result

    def on_activate(self, _state: LifecycleState) -> Ended:
        """Activate the node."""
        result = self._tried(self.activate)
        self.active = result == Ended.SUCCESS
        return result

    def on_deactivate(self, _state: LifecycleState) -> Ended:
        """Act safely, then stop all activity."""
        last = functools.partial(self.safe, self.INACTIVE)
        result = self._tried(last) if self.active else Ended.SUCCESS
        self.active = False
        return result

    def on_cleanup(self, _state: LifecycleState) -> Ended:
        """Destroy all endpoints created since the node was configured."""
        self.flush()  # a publisher destroyed at once may take its safe command with it
        for each, kind in self._endpoints().items():
            if each not in self._lasting:
                getattr(self, f'destroy_{kind}')(each)
        self.configured = False
        return Ended.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> Ended:
        """Stop all work for good; the process remains until a signal ends it."""
        self.on_deactivate(state)
        return self.on_cleanup(state)

    on_error = on_shutdown  # of a failed transition

    def flush(self) -> None:
        """Wait until the last messages have arrived, but not for long: a subscriber may hang."""
        end = self.steady_now() + ACKNOWLEDGED
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - self.steady_now())))

    def _endpoints(self) -> dict[Any, str]:
        return {each: kind for kind in ENDPOINTS for each in getattr(self, f'{kind}s')}

    def _tried(self, change: Callable[[], None]) -> Ended:
        """Run a part of a transition; bad input only refuses it, other exceptions are errors."""
        try:
            change()
        except BaseException as error:  # a panic of a library written in Rust is no Exception
            self._error = self._error or error  # the first error is the one to report
            return Ended.FAILURE if isinstance(error, BadInput) else Ended.ERROR
        return Ended.SUCCESS

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> Any:
        """Perform the requested transition if possible now; else rclpy would stop spinning."""
        transition, state = request.transition, self._state_machine.current_state[1]
        possible = {each[0]: each[1] for each in self._state_machine.available_transitions}
        wanted = transition.label or possible.get(transition.id, f'transition {transition.id}')
        if wanted not in possible.values():
            allowed = ', '.join(f'{label} ({number})' for number, label in possible.items())
            self.get_logger().warning(f'{wanted} is not possible while {state}; allowed: {allowed}')
            response.success = False
            return response
        self._error = None
        answer = self._change(request, response)
        if self._error is not None:
            self.get_logger().error(f'{wanted} failed: {_said(self._error)}')
        return answer


def _said(error: BaseException) -> str:
    """Return an error in words, with its type unless it is bad input."""
    return str(error) if isinstance(error, BadInput) else f'{type(error).__name__}: {error}'


class NodeClock:
    """Monitors the clock of a node.

    Args:
        step: largest regular step of simulated time [s].
        on_jump: called with a jump of time [s]: of simulated time back, or forward by more than a
            step; of system time by more than ``CLOCK_SET``.

    Attributes:
        simulated: whether time comes from ``/clock``; constant while the node runs.
    """

    def __init__(self, node: Managed, step: float, on_jump: Callable[[float], None]) -> None:
        self._clock, self._on_jump = node.get_clock(), on_jump
        self.simulated = bool(node.get_parameter('use_sim_time').value)
        self._offset = math.nan  # from the steady clock to this one [s]; unknown at first
        self._stood = -1, 0.0  # last time shown [ns], and since when [s]
        threshold = JumpThreshold(
            min_forward=Duration(seconds=step),
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=False,
        )
        self._jumps = self._clock.create_jump_callback(
            threshold, post_callback=node.guard(self._on_simulated_jump)
        )

    @property
    def nanoseconds(self) -> int:
        """Return the time of the clock [ns]; 0 until simulated time starts."""
        return self._clock.now().nanoseconds

    def standstill(self, patience: float) -> str:
        """Return a message if simulated time has stopped for longer than ``patience`` [s]."""
        if not self.simulated:
            return ''
        shown, now = self.nanoseconds, time.monotonic()
        if self._stood[0] != shown:
            self._stood = shown, now
        stood = now - self._stood[1]
        if stood <= patience:
            return ''
        if shown:
            return f'the clock has stood still for {stood:.2f} s'
        return (
            f'use_sim_time is true, and nothing has come on /clock for {stood:.2f} s: start what '
            'publishes it (a simulator, ros2 bag play --clock), or set use_sim_time to false'
        )

    def look(self) -> None:
        """Detect whether the system clock was set, of which there is no notification."""
        before, shown, after = time.monotonic(), self.nanoseconds, time.monotonic()
        if self.simulated or after - before > HELD_UP:
            return
        last, self._offset = self._offset, shown / SECOND - after
        if abs(self._offset - last) > CLOCK_SET:  # False for the first one
            self._on_jump(self._offset - last)

    def _on_simulated_jump(self, jump: TimeJump) -> None:
        if self.nanoseconds != jump.delta.nanoseconds:  # else it has just started
            self._on_jump(jump.delta.nanoseconds / SECOND)


FAILED = 1  # exit code
FAREWELLS = 3  # safe commands at shutdown
ACKNOWLEDGED = 1.0  # [s] for the last messages to arrive
LIFE = 0.1  # [s] liveliness lease of a planner, for its monitors
SPIN = 0.05  # [s] longest response to a signal
LAST_RESORT = 30.0  # [s] after which a process that hangs on exit is ended
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
SECURITY = 'ROS_SECURITY_ENABLE'
ARGUMENTS = 'arguments of ROS: --params-file FILE, -p NAME:=VALUE, -r FROM:=TO, -r __ns:=/NS'
USAGE = f"""\
{ARGUMENTS}
exit codes: 0 done or ended by a signal, 1 failed, 2 bad input

parameters (name, default, meaning):"""


def qos(depth: int = 1, lease: float = 0.0, **policies: Any) -> QoSProfile:
    """Return a quality of service that keeps the last ``depth`` messages, by default reliably.

    With a ``lease`` [s], DDS offers or requires liveliness of the process at this interval.
    """
    return QoSProfile(
        depth=depth,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(nanoseconds=round(1e9 * lease)),
        **policies,
    )


LATEST = qos(reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = qos(durability=DurabilityPolicy.TRANSIENT_LOCAL)


def full_name(endpoint: Any) -> str:
    """Return the full name of the node that owns an endpoint of a topic in the graph."""
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


@contextmanager
def attached(
    name: str, executor: str = 'wait_set', **options: Any
) -> Iterator[tuple[Node, Executor]]:
    """Yield a node with its own context, and its executor, for processes other than ROS nodes.

    ``options`` are those of ``rclpy.create_node``.
    """
    with Context() as context, ExitStack() as stack:
        node = rclpy.create_node(name, context=context, **options)
        stack.callback(node.destroy_node)
        spinning = stack.enter_context(executor_named(executor, context))
        spinning.add_node(node)
        yield node, spinning


def executor_named(name: str, context: Context | None = None) -> Executor:
    """Return a new executor, ``wait_set`` or ``events``; the context defaults to rclpy's.

    Raises:
        BadInput: this rclpy has no events executor.
    """
    if name == 'wait_set':
        return SingleThreadedExecutor(context=context)
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        raise BadInput('executor', name, 'wait_set: this rclpy is older than 7.1.4') from None
    return EventsExecutor(context=context)


def run(node_type: type[Managed]) -> int:
    """Run a node until it is done or stopped, and return the exit code.

    A signal during the start ends the process at once: no command has been sent yet. BadInput from
    the node's creation ends it with code 2 and one line.
    """
    os.environ.setdefault(RANGE, 'LOCALHOST')
    os.environ.setdefault('HOME', os.path.expanduser('~'))  # where ROS logs; services may lack it
    leave_at_signals()
    try:
        sections = spec.given_sections()
        with ExitStack() as stack:
            try:
                stack.enter_context(get_default_context())  # unlike rclpy.init, without signals
            except rclpy_implementation.UnknownROSArgsError as error:
                unknown = f'unknown argument {" ".join(ast.literal_eval(str(error)))}'
                raise BadInput.stating('command line', unknown, f'allowed: {ARGUMENTS}') from None
            except RuntimeError as error:  # malformed rule, parameter file or domain
                hint = f'; allowed: {ARGUMENTS}' if 'rule' in str(error) else ''
                return _ended(f'{error}{hint}', BAD_INPUT)
            _require_ros_arguments(node_type)
            stack.enter_context(warnings.catch_warnings())
            warnings.simplefilter('ignore', RuntimeWarning)  # failures of rclpy's own cleanup
            node = node_type()
            stack.callback(_destroy, node)
            full = node.get_fully_qualified_name()
            for lost in spec.unused(sections, full, node.kind):
                node.get_logger().warning(f'{lost} is not for {full}: not used')
            for lost in spec.outvoted(node.given, full):
                node.get_logger().warning(lost)
            node.begin()
            return _live(node)
    except (BadInput, InvalidParameterTypeException) as error:  # use_sim_time of another type
        return _ended(error, BAD_INPUT)
    except rclpy_implementation.RCLError as error:  # for example, security is required but missing
        return _ended(f'the node cannot be created: {error}', FAILED)
    finally:
        _end_at_last()  # the interpreter's exit cleans up the rest


def _destroy(node: Managed) -> None:
    """Destroy a node; else its publishers would be deleted at the exit, after the context."""
    _end_at_last()
    with suppress(RuntimeError):  # of rclpy, after an earlier failure, which is to be reported
        node.destroy_node()


def _ended(error: object, code: int) -> int:
    """Print an error in one line, with the requirements of security if enabled; return the code."""
    line = ' '.join(str(error).split())
    if os.environ.get(SECURITY) == 'true':
        line += f' ({SECURITY}=true needs ROS_SECURITY_KEYSTORE and a middleware with security)'
    print(line, file=sys.stderr)
    return code


def _require_ros_arguments(node_type: type[Managed]) -> None:
    """Reject arguments that would be ignored; print the usage and exit for --help."""
    lines = [USAGE]
    for each in sorted(node_type.specs, key=attrgetter('name')):
        lines.append(f'  {each.name}  {json.dumps(each.default)} {each.unit}'.rstrip())
        lines.append(textwrap.indent(textwrap.fill(each.description, 74), ' ' * 6))
    parser = argparse.ArgumentParser(
        usage=f'{node_type.kind} [--ros-args ARGUMENT...]',
        epilog='\n'.join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _, plain = parser.parse_known_args(remove_ros_args(args=sys.argv)[1:])
    if plain:
        problem = f'{shlex.join(plain)} must follow --ros-args'
        raise BadInput.stating('command line', problem, f'allowed: --ros-args, then {ARGUMENTS}')


def _live(node: Managed) -> int:
    """Spin a node until it is done or signalled, send final safe commands; return its code."""
    received: list[int] = []  # SIGINT and SIGTERM from now on

    def take(number: int, _frame: Any) -> None:
        _end_at_last()
        received.append(number)

    for number in SIGNALS:
        signal.signal(number, take)
    for name, closed in ((RANGE, ('LOCALHOST', 'OFF')), (PEERS, (None, ''))):
        if (value := os.environ.get(name)) not in closed:
            node.get_logger().warning(f'{name}={value}: open to other machines')
    executor = executor_named(node.settings.executor)
    executor.add_node(node)
    spin = node.guard(executor.spin_once)  # callbacks of rclpy itself fail on a malformed /clock
    # Objects of the start are permanent: each full collection would scan them for 60 ms.
    gc.freeze()
    gc.enable()
    while not received and node.exit_code is None:
        spin(SPIN)
    _end_at_last()
    if received:
        node.get_logger().info(f'received {signal.Signals(received[0]).name}, stopping')
    for _ in range(FAREWELLS):
        node.guard(node.safe)(Reason(Cause.SHUTDOWN, 'shutting down'))
    node.flush()
    executor.shutdown()
    return node.exit_code or DONE


def _end_at_last() -> None:
    """End this process after LAST_RESORT with code 1 and a traceback, unless it ends by itself.

    The threads of a middleware can block its cleanup forever (eProsima/Fast-DDS#6502), or for
    minutes (#6513). The timer runs outside of Python and needs no responsive thread.
    """
    faulthandler.dump_traceback_later(LAST_RESORT, exit=True)

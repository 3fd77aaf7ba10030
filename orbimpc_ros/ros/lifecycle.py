# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A managed node: work that is set up, begun, ended and cleared away by lifecycle transitions.

rclpy's own managed node swallows what a transition raises, and ends spinning where one is asked
for that is not possible: here both are said in a line, and the node goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.process import Guarded

ENDPOINTS = ('publisher', 'subscription', 'service', 'timer')
SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


class Managed(LifecycleNodeMixin, Guarded):
    """A guarded node with a life cycle.

    A subclass declares its parameters when it is made, and does the rest in the four methods
    ``configure``, ``activate``, ``deactivate`` and ``clean_up``. What it creates while it is
    configured is destroyed when that ends, however it ends.
    """

    def __init__(self, name: str, parameters: Sequence[Parameter] = ()) -> None:
        Guarded.__init__(self, name, parameters)
        self._lasting: set[Any] | None = None  # endpoints that it has unconfigured
        self._error: BaseException | None = None  # of the last transition
        LifecycleNodeMixin.__init__(self)
        self._change: Callable[[Any, Any], Any] = self._service_change_state.callback
        self._service_change_state.callback = self.guard(self._on_change_state)

    # --- what a subclass does

    def configure(self) -> None:
        """Create all that work takes.

        Raises:
            BadInput: the parameters do not allow it; the node stays unconfigured.
        """

    def activate(self) -> None:
        """Begin, from a fresh start."""

    def deactivate(self) -> None:
        """Do for the last time what is safe; the node is still active."""

    def clean_up(self) -> None:
        """Let go of what is not an endpoint of this node."""

    # --- what it uses

    def begin(self) -> None:
        """Configure and activate the node, unless somebody else is to do so.

        Raises:
            BaseException: whatever keeps it from being active.
        """
        if not self.get_parameter('autostart').value:
            self.get_logger().info('unconfigured: waits for ~/change_state')
            return
        self._error = None
        for trigger in (self.trigger_configure, self.trigger_activate):
            try:
                trigger()
            except RuntimeError:  # rclpy cannot tell others of the transition
                if self._error is None:
                    raise
            if self._error is not None:
                raise self._error

    # --- transitions

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Set up, or clear away what was set up of it."""
        self._lasting = self._endpoints()
        result = self._tried(self.configure)
        if result != SUCCESS:
            self._clear_away()
        return result

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        result = self._tried(self.activate)
        self.active = result == SUCCESS
        return result

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Be safe, then silent."""
        return self._stopped()

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Become as it was before it was configured."""
        return self._clear_away()

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """End all work for good; the process stays until it is told to end."""
        self._stopped()
        return self._clear_away()

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that went wrong: silent and unconfigured."""
        self._stopped()
        return self._clear_away()

    def _stopped(self) -> TransitionCallbackReturn:
        if not self.active:
            return SUCCESS
        try:
            return self._tried(self.deactivate)
        finally:
            self.active = False

    def _clear_away(self) -> TransitionCallbackReturn:
        """Destroy what was created since the node was configured."""
        if self._lasting is None:
            return SUCCESS
        result = self._tried(self.clean_up)
        for kind in ENDPOINTS:
            for each in [*getattr(self, f'{kind}s')]:
                if each not in self._lasting:
                    getattr(self, f'destroy_{kind}')(each)
        self._lasting = None
        return result

    def _endpoints(self) -> set[Any]:
        return {each for kind in ENDPOINTS for each in getattr(self, f'{kind}s')}

    def _tried(self, change: Callable[[], None]) -> TransitionCallbackReturn:
        """Do a part of a transition; bad input only refuses it, anything else is an error."""
        try:
            change()
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a panic of a library written in Rust is no Exception
            self._error = self._error or error  # what goes wrong first is what to tell
            return FAILURE if isinstance(error, BadInput) else ERROR
        return SUCCESS

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> Any:
        """Do what is asked for if it is possible now; rclpy would end spinning where it is not."""
        asked, state = request.transition, self._state_machine.current_state[1]
        possible = {found[0]: found[1] for found in self._state_machine.available_transitions}
        wanted = asked.label or possible.get(asked.id, f'transition {asked.id}')
        if wanted not in possible.values():
            allowed = ', '.join(f'{label} ({number})' for number, label in possible.items())
            self.get_logger().warning(f'{wanted} is not possible while {state}; allowed: {allowed}')
            response.success = False
            return response
        self._error = None
        answer = self._change(request, response)
        if self._error is not None:
            kind = '' if isinstance(self._error, BadInput) else f'{type(self._error).__name__}: '
            self.get_logger().error(f'{wanted} failed: {kind}{self._error}')
        return answer

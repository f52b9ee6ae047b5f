# SPDX-License-Identifier: Apache-2.0
"""The base of every node: it survives any message, and refuses values of parameters that cannot be."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.sound import require_sound

__all__ = ["GuardedNode"]

_BYTES = 16_000_000  # of a message: a session's description of 100 000 targets
_TOLD = 200  # characters of a reason


class GuardedNode(Node):
    """A node that goes on whatever it is sent.

    All that calls the node passes here: its subscriptions, that of its clock included, its timers, and its services. A
    message that means nothing, or that its callback cannot use, is ignored; the log says so once for each topic.

    Args:
        name: of the node.
        more: as of any node.

    Attributes:
        ignored: messages that were ignored, by topic.
        choices: values of a parameter that are allowed, by its name.
    """

    def __init__(self, name: str, **more: Any) -> None:
        # before the node's own start, which subscribes to the clock
        self.ignored: dict[str, int] = {}
        self._last_ignored = ""
        self._failed: set[str] = set()
        self.choices: dict[str, tuple[str, ...]] = {}
        super().__init__(name, **more)
        self.add_on_set_parameters_callback(self._set)

    @property
    def ignored_entries(self) -> dict[str, object]:
        """For a status: how many messages were ignored, and why the last one was."""
        return {"ignored": sum(self.ignored.values()), "ignored_last": self._last_ignored}

    @property
    def lives_in_simulated_time(self) -> bool:
        """Whether the node's time is that of `/clock` (parameter `use_sim_time`)."""
        return bool(self.get_parameter("use_sim_time").value)

    def declare(
        self,
        name: str,
        default: Any,
        description: str,
        *,
        unit: str = "",
        low: float | None = None,
        high: float | None = None,
        choices: tuple[str, ...] = (),
        read_only: bool = True,
    ) -> Any:
        """Declare a parameter and return its value.

        Args:
            name: its name.
            default: its value where nobody sets it; gives the type.
            description: what it does.
            unit: of a number.
            low: least value.
            high: greatest value.
            choices: of a text.
            read_only: whether it can be set at the start only.
        """
        descriptor = ParameterDescriptor(
            name=name,
            description=f"{description} [{unit}]" if unit else description,
            read_only=read_only,
            additional_constraints=f"one of {', '.join(choices)}" if choices else "",
        )
        if low is not None or high is not None:
            low, high = (-1e308 if low is None else low), (1e308 if high is None else high)
            if isinstance(default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
            elif isinstance(default, int):
                low, high = max(low, -(2**63)), min(high, 2**63 - 1)
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        if choices:
            self.choices[name] = choices
        return self.declare_parameter(name, default, descriptor).value

    def every(self, period: float, callback: Callable[[], None]) -> Timer:
        """Have a function called every so many seconds of a clock that neither jumps nor follows `/clock`."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], None], qos_profile: Any, **more: Any
    ) -> Subscription:
        """As of any node; the callback gets sound messages only, and may refuse one by an exception."""

        def guarded(data: bytes) -> None:
            try:
                # before anything is made of it: a million texts leave holes in the interpreter's memory
                if len(data) > _BYTES:
                    raise CalibrationError(f"it has {len(data)} bytes")
                message = deserialize_message(data, msg_type)
                require_sound(message)
                callback(message)
            except Exception as error:
                self._ignore(topic, _reason(error))

        return super().create_subscription(msg_type, topic, guarded, qos_profile, raw=True, **more)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], None], *arguments: Any, **more: Any
    ) -> Timer:
        """As of any node; an exception does not end the node."""
        return super().create_timer(timer_period_sec, self.guarded(callback), *arguments, **more)

    def guarded(self, callback: Callable[[], None]) -> Callable[[], None]:
        """A function that calls another and does not raise; a fault is logged once."""

        def call() -> None:
            try:
                callback()
            except Exception as error:
                self._fail(getattr(callback, "__name__", "a callback"), error)

        return call

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **more: Any) -> Service:
        """As of any node; a handler that fails answers so, where the answer has room for it."""

        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                self._fail(srv_name, error)
                if hasattr(response, "success"):
                    response.success, response.message = False, _reason(error)
                return response

        return super().create_service(srv_type, srv_name, guarded, **more)

    def check_parameters(self, wanted: Mapping[str, Any]) -> None:
        """Refuse values that the node could not use; for nodes to override.

        Args:
            wanted: the values that are about to be set, by name.

        Raises:
            CalibrationError: one cannot be used; nothing is set then.
        """

    def _ignore(self, topic: str, reason: str) -> None:
        first = topic not in self.ignored
        self.ignored[topic] = self.ignored.get(topic, 0) + 1
        self._last_ignored = f"{topic}: {reason}"
        if first:
            self.get_logger().warning(f"a message on {topic} was ignored: {reason}; more of them are only counted")

    def _fail(self, what: str, error: Exception) -> None:
        """A fault of the node's own: the log says once where."""
        text = f"{what}: {_reason(error)}"
        if text not in self._failed:
            self._failed.add(text)
            self.get_logger().error(text + "\n" + "".join(traceback.format_exception(error)))

    def _set(self, parameters: list[Parameter]) -> SetParametersResult:
        wanted = {parameter.name: parameter.value for parameter in parameters}
        try:
            for name, value in wanted.items():
                if isinstance(value, float) and not math.isfinite(value):
                    raise CalibrationError(f"parameter {name} is {value}, not a finite number")
                choices = self.choices.get(name)
                if choices and value not in choices:
                    raise CalibrationError(f"parameter {name} is {value!r}, not one of {', '.join(choices)}")
            self.check_parameters(wanted)
        except CalibrationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _reason(error: Exception) -> str:
    """One short line."""
    text = str(error) if isinstance(error, CalibrationError) else f"{type(error).__name__}: {error}"
    line = " ".join(text.split())
    return line if len(line) <= _TOLD else f"{line[:_TOLD]}…"

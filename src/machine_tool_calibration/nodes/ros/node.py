# SPDX-License-Identifier: Apache-2.0
"""The base of every node: it survives any message, refuses values of parameters that cannot be, and has a lifecycle."""

import inspect
import math
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import resources
from typing import Any

import yaml
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray, String

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.nodes.ros.sound import require_sound

_PARAMETERS = resources.files("machine_tool_calibration.nodes") / "parameters.yaml"
_BYTES = 1_000_000  # of a message: to make it of small parts takes up to 0.6 s, in which the node answers nobody
_BULK_BYTES = 16_000_000  # of one whose content is one text or array: a session's description of 100 000 targets
_BULK = (String, PointCloud2, Float64MultiArray)
_REASON_LENGTH = 200  # characters of a reason
# A service's usual queue holds 10 requests of all its clients, and each client's 10 answers, those to the other clients
# among them: what comes in a burst beyond that is lost without a word.
CALLS = QoSProfile(depth=1000)
_FAREWELL = 0.5  # s in which the last messages arrive; one that has been killed never has them
_LOOK_FOR_NAMESAKES, _LOOKS_AT_NAMESAKES = 10.0, 3  # s; a node that was killed is known for some 20 s
OF_ROS = ("use_sim_time", "start_type_description_service")
"""Parameters that every node has."""


def parameters_of(kind: str) -> dict[str, Any]:
    """The parameters of a node, by its module's name: entries of `parameters.yaml`."""
    every = yaml.safe_load(_PARAMETERS.read_text(encoding="utf-8"))
    return {**every["every_node"], **every[kind]}


class GuardedNode(Node):  # type: ignore[misc]  # rclpy comes without types
    """A node that goes on whatever it is sent.

    All that calls the node passes here: its subscriptions, that of its clock included, its timers, and its services. A
    message that means nothing, or that its callback cannot use, is ignored; the log says so once for each topic.
    """

    is_configured = False  # whether what the parameters name is in use

    def __init__(self, name: str, **more: Any) -> None:
        # before the node's own start, which subscribes to the clock
        self.ignored: dict[str, int] = {}  # messages that were ignored, by topic
        self._last_ignored = ""
        self._failed: set[str] = set()
        self.choices: dict[str, tuple[str, ...]] = {}  # values of a parameter that are allowed, by its name
        self._fixed = {"use_sim_time"}  # parameters that are set while the node is not configured
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **more)
        # what was given, until the node declares it
        self._given = set(self.get_parameters_by_prefix("")) - set(OF_ROS)
        if not isinstance(clock := self.get_parameter("use_sim_time").value, bool):
            raise CalibrationError(f"parameter use_sim_time is {clock!r}, neither true nor false")
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
        says: str,
        unit: str = "",
        within: Sequence[float | None] = (None, None),
        *,
        choices: Sequence[str] = (),
        read_only: bool = True,
        in_simulated_time: Any = None,
    ) -> None:
        """Declare a parameter by an entry of `parameters.yaml`."""
        if in_simulated_time is not None and self.lives_in_simulated_time:
            default = in_simulated_time
        if name in self._given:
            self._given.discard(name)
            self.undeclare_parameter(name)
        constraints = [f"one of {', '.join(choices)}"] if choices else []
        if read_only:
            self._fixed.add(name)
            constraints.append("set while the node is not configured")
        descriptor = ParameterDescriptor(
            name=name, description=f"{says} [{unit}]" if unit else says, additional_constraints="; ".join(constraints)
        )
        if any(end is not None for end in within):
            low, high = (-1e308 if within[0] is None else within[0]), (1e308 if within[1] is None else within[1])
            if isinstance(default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
            elif isinstance(default, int):
                low, high = max(low, -(2**63)), min(high, 2**63 - 1)
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        if choices:
            self.choices[name] = tuple(choices)
        self.declare_parameter(name, default, descriptor)

    def say_unknown_parameters(self) -> None:
        """A parameter that was given and that the node does not have would be passed over without a word."""
        known = sorted(set(self.get_parameters_by_prefix("")) - self._given)
        for name in sorted(self._given):
            if not name.startswith("qos_overrides."):
                hint = did_you_mean(name, known) or f"; it has {', '.join(known)}"
                self.get_logger().warning(f"this node has no parameter {name!r}{hint}")
                self.undeclare_parameter(name)
        self._given = set()

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
                if len(data) > (_BULK_BYTES if msg_type in _BULK else _BYTES):
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
                self.note_fault(getattr(callback, "__name__", "a callback"), error)

        return call

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **more: Any) -> Service:
        """As of any node, whose handler may be a coroutine; one that fails answers so, where the answer has room."""

        async def guarded(request: Any, response: Any) -> Any:
            try:
                answered = callback(request, response)
                return await answered if inspect.isawaitable(answered) else answered
            except Exception as error:
                if not isinstance(error, CalibrationError):  # that is a refusal, and no fault of the node's
                    self.note_fault(srv_name, error)
                if hasattr(response, "success"):
                    response.success, response.message = False, _reason(error)
                return response

        return super().create_service(srv_type, srv_name, guarded, **{"qos_profile": CALLS, **more})

    def create_client(self, srv_type: Any, srv_name: str, **more: Any) -> Client:
        """As of any node, with a queue that other clients' answers do not fill."""
        return super().create_client(srv_type, srv_name, **{"qos_profile": CALLS, **more})

    def check_parameters(self, wanted: Mapping[str, Any]) -> None:
        """Refuse values that the node could not use by a CalibrationError; for nodes to override."""

    def _ignore(self, topic: str, reason: str) -> None:
        first = topic not in self.ignored
        self.ignored[topic] = self.ignored.get(topic, 0) + 1
        self._last_ignored = f"{topic}: {reason}"
        if first:
            self.get_logger().warning(f"a message on {topic} was ignored: {reason}; more of them are only counted")

    def note_fault(self, what: str, error: Exception) -> None:
        """A fault of the node's own: the log says once where."""
        text = f"{what}: {_reason(error)}"
        if text not in self._failed:
            self._failed.add(text)
            self.get_logger().error(text + "\n" + "".join(traceback.format_exception(error)))

    def _set(self, parameters: list[Parameter]) -> SetParametersResult:
        wanted = {parameter.name: parameter.value for parameter in parameters}
        try:
            for name, value in wanted.items():
                if name in self._fixed and self.is_configured:
                    raise CalibrationError(f"parameter {name} cannot be set while the node is configured")
                if isinstance(value, float) and not math.isfinite(value):
                    raise CalibrationError(f"parameter {name} is {value}, not a finite number")
                choices = self.choices.get(name)
                if choices and value not in choices:
                    raise CalibrationError(f"parameter {name} is {value!r}, not one of {', '.join(choices)}")
            self.check_parameters(wanted)
        except CalibrationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


class ManagedNode(LifecycleNodeMixin, GuardedNode):  # type: ignore[misc]
    """A managed node: what `ros2 lifecycle` and a lifecycle manager can configure, activate and take down again.

    *Unconfigured* it has its parameters, which can be set. *Inactive* it has read what they name (files, a device) and
    is in nobody's way. *Active* it takes part in the graph: only then it has its topics, services and timers, so that
    nothing latched is heard, and lost, too early; activated again it begins anew. Its name is its module's by default.
    """

    def __init__(self) -> None:
        self._is_active = self._is_starting = False
        kind = type(self).__module__.rpartition(".")[2]
        GuardedNode.__init__(self, kind)
        LifecycleNodeMixin.__init__(self)
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = partial(_change_state, service.callback)
        self.fault = ""  # why the last transition failed; empty if it did not
        self.done = False  # whether the node has nothing more to do, which ends its process
        self._kept: set[Any] = set()  # what the node has before it is activated
        entries = parameters_of(kind)
        for name, entry in entries.items():  # what rclpy would take letter by letter, or pass over
            if isinstance(entry["default"], list) and isinstance(given := self.get_parameter_or(name).value, str):
                raise CalibrationError(f"parameter {name} is a list: {name}:=[{given}]")
        for name, entry in entries.items():
            self.declare(name, **entry)
        (self.autostart,) = self.values("autostart")
        self._settings()
        self.say_unknown_parameters()
        self._namesakes = 0
        self.every(_LOOK_FOR_NAMESAKES, self._look_for_namesakes)

    def _look_for_namesakes(self) -> None:
        """Say once that another node has the same name, whose services are the same; one that was killed soon has not.

        Both answer a call, and whoever calls hears one of them.
        """
        mine = (self.get_name(), self.get_namespace())
        self._namesakes = self._namesakes + 1 if self.get_node_names_and_namespaces().count(mine) > 1 else 0
        if self._namesakes == _LOOKS_AT_NAMESAKES:
            name = self.get_fully_qualified_name()
            self.get_logger().warning(
                f"another node is called {name}, and answers the same services: one of both must go"
            )

    def values(self, *names: str) -> list[Any]:
        """What parameters of these names are set to."""
        return [self.get_parameter(name).value for name in names]

    def site_and_origin(self) -> tuple[str, int]:
        """The parameters `site` and `time_origin`: the file, and the ROS time at which the site's time is zero, ns."""
        file, origin = self.values("site", "time_origin")
        return file, round(origin * 1e9) or time.time_ns()

    # --- for nodes to override; they raise CalibrationError where it cannot be done

    def _settings(self) -> None:
        """Take the values of the parameters; called at the start, and again when it is configured."""

    def _configure(self) -> None:
        """Read what the parameters name."""

    def _activate(self) -> None:
        """Begin anew: create topics, services and timers."""

    def _deactivate(self) -> None:
        """Leave in order; topics, services and timers are destroyed afterwards."""

    # --- the transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take the parameters as they are now, and read what they name."""
        return self._transit("configured", self._settings, self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Join the graph."""
        self._kept = set(self._entities())
        outcome = self._transit("activated", self._activate)
        self._is_active = outcome == TransitionCallbackReturn.SUCCESS
        if not self._is_active:
            self._leave_graph()
        return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the graph."""
        self.guarded(self._deactivate)()
        self._leave_graph()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Be as at the start."""
        self.is_configured = False
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End in order, from whatever state; the process ends with it."""
        if self._is_active:
            self.on_deactivate(state)
        if self.is_configured:
            self.on_cleanup(state)
        self.done = True
        return TransitionCallbackReturn.SUCCESS

    def start(self) -> None:
        """Configure and activate the node; raises CalibrationError where it cannot be, and logs nothing of it."""
        self._is_starting = True
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise CalibrationError(self.fault)
        self._is_starting = False

    def _transit(self, what: str, *steps: Callable[[], None]) -> TransitionCallbackReturn:
        self.fault = ""
        try:
            for step in steps:
                step()
        except Exception as error:
            self.fault = _reason(error)
            if not isinstance(error, CalibrationError):
                self.note_fault(what, error)
            elif not self._is_starting:
                self.get_logger().error(f"not {what}: {self.fault}")
            return TransitionCallbackReturn.FAILURE
        self.is_configured = True
        return TransitionCallbackReturn.SUCCESS

    def _entities(self) -> list[Any]:
        return [*self.subscriptions, *self.publishers, *self.timers, *self.services, *self.clients]

    def _leave_graph(self) -> None:
        self._is_active = False
        gone = set(self._entities()) - self._kept
        deadline = time.monotonic() + _FAREWELL
        for publisher in gone.intersection(self.publishers):  # with it goes what its subscribers do not have yet
            publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
        for entities, destroy in (
            (self.timers, self.destroy_timer),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.publishers, self.destroy_publisher),
        ):
            for entity in [one for one in entities if one in gone]:
                destroy(entity)


def _change_state(change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    """Answer also where the state has no such transition: rclpy raises, and whoever asked would wait for ever."""
    try:
        return change(request, response)
    except RuntimeError:  # rclpy's own has no public name; the log has said which transition it was
        response.success = False
        return response


def _reason(error: Exception) -> str:
    text = str(error) if isinstance(error, CalibrationError) else f"{type(error).__name__}: {error}"
    line = " ".join(text.split())
    return line if len(line) <= _REASON_LENGTH else f"{line[:_REASON_LENGTH]}…"

# SPDX-License-Identifier: Apache-2.0
"""The frame of every node's process: parameters, start, spin, and a clean stop on SIGINT and SIGTERM."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.shared import shared_file
from machine_tool_calibration.nodes.usage import usage

__all__ = [
    "STOP_GRACE",
    "declare",
    "default_environment",
    "post",
    "run",
    "run_process",
    "say_unknown_parameters",
    "use_sim_time",
]


def declare(
    node: GuardedNode,
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
        node: whose parameter it is.
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
        node.choices[name] = choices
    return node.declare_parameter(name, default, descriptor).value


STOP_GRACE = 1.8  # s: nodes that have nothing to save end within 2 s, whatever happens
_SAVE_GRACE = 30.0  # s: others may have a disk to wait for
_STOPS = {signal.SIGINT, signal.SIGTERM}
_TICK = 0.1  # s
# of the middleware, which are the user's
_OWN_SETTINGS = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML")


def default_environment() -> None:
    """Discover on this machine only, unless the user says otherwise: the wheels have no security (SROS2).

    Logs go where they can be written: without that no node starts for a user who has no home. The middleware gives back
    the memory of large messages (`config/fastdds.xml`), unless the user has settings of his own.
    """
    if "ROS_LOCALHOST_ONLY" not in os.environ:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if not any(os.environ.get(name) for name in _OWN_SETTINGS):
        with suppress(CalibrationError):  # a checkout that was taken apart: nothing but memory depends on it
            os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(shared_file("config/fastdds.xml"))
            os.environ["RMW_FASTRTPS_USE_QOS_FROM_XML"] = "1"
    if not os.environ.get("ROS_LOG_DIR") and not os.environ.get("ROS_HOME"):
        logs = Path(os.path.expanduser("~"), ".ros", "log")
        there = next(folder for folder in (logs, *logs.parents) if folder.exists())
        if not (logs.is_absolute() and there.is_dir() and os.access(there, os.W_OK)):
            os.environ["ROS_LOG_DIR"] = str(Path(tempfile.gettempdir(), f"ros-log-{os.getuid()}"))


def run(create: Callable[[], GuardedNode], args: list[str] | None = None, *, grace: float = _SAVE_GRACE) -> int:
    """Run a node until SIGINT, SIGTERM or an external shutdown.

    A node may have a method `close()`, which is called before it is destroyed, and an attribute `done`, which ends it
    once it is true.

    Args:
        create: makes the node; called after rclpy is up.
        args: command line, by default the process's own.
        grace: a node that has not ended so long after the signal is ended by force, s.

    Returns:
        Exit status: 0 stopped as asked, 1 the node could not start (one line on standard error).
    """
    default_environment()
    stop = threading.Event()
    # A thread waits for the signals: it can end the process even where the middleware holds the main thread.
    # Threads started from here on, the middleware's own, inherit the mask.
    # A signal that a thread from before takes (BLAS, a timer) comes to these handlers instead.
    for number in _STOPS:
        signal.signal(number, lambda *_: stop.set())
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    threading.Thread(target=_await_stop, args=(stop, grace), name="signals", daemon=True).start()
    # rclpy's own handlers end the context while callbacks run; without them the loop below finishes first
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node: GuardedNode | None = None
    executor = None
    status = 0
    try:
        node = create()
        say_unknown_parameters(node)
        executor = EventsExecutor()
        executor.add_node(node)
        node._post = executor.create_task  # type: ignore[attr-defined]
        while not stop.is_set() and rclpy.ok() and not getattr(node, "done", False):
            # spin() of this executor hangs in Jazzy
            executor.spin_once(timeout_sec=_TICK)
    except ExternalShutdownException:
        pass
    except (CalibrationError, ParameterException) as error:
        name = node.get_name() if node is not None else Path(sys.argv[0]).stem
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        status = 1
    finally:
        if node is not None and hasattr(node, "close"):
            node.close()
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
    return status


def run_process(create: Callable[[], GuardedNode], args: list[str] | None = None, *, grace: float = _SAVE_GRACE) -> int:
    """As `run`, and end the process once a node has run: what it had to save is saved.

    Asked for help, it prints what the node is and takes, and starts nothing.

    An interpreter that tidies up, or waits for a calculation that nobody wants any more, could take seconds under load.

    Returns:
        Exit status where no node was wanted, but help.
    """
    if _asks_for_help(sys.argv[1:] if args is None else args):
        return _help(sys.modules[create.__module__])
    status = run(create, args, grace=grace)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def say_unknown_parameters(node: GuardedNode) -> None:
    """A parameter that was given and that the node does not have would be passed over without a word."""
    for name in sorted(node._parameter_overrides):
        if not node.has_parameter(name):
            known = sorted(other for other in node._parameters if "." not in other)
            hint = did_you_mean(name, known) or f"; it has {', '.join(known)}"
            node.get_logger().warning(f"this node has no parameter {name!r}{hint}")


def _asks_for_help(args: list[str]) -> bool:
    own = args[: args.index("--ros-args")] if "--ros-args" in args else args
    return "--help" in own or "-h" in own


def _help(module: ModuleType) -> int:
    name = Path(str(module.__file__)).stem
    try:
        print(usage(name, str(module.__doc__)), flush=True)
    except BrokenPipeError:  # its reader has seen enough; what is still buffered goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except CalibrationError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    return 0


def _await_stop(stop: threading.Event, grace: float) -> None:
    """Set the event at the first signal; end the process where that does not help."""
    signal.sigwait(_STOPS)
    stop.set()
    time.sleep(grace)
    faulthandler.dump_traceback(all_threads=True)
    print(f"not ended {grace:g} s after the signal: ended by force", file=sys.stderr, flush=True)
    os._exit(1)


def post(node: GuardedNode, function: Callable[[], None]) -> None:
    """Have a function called in the node's own thread; may be called from any thread.

    An exception in the function is logged: this executor would crash on it.
    """
    node._post(node.guarded(function))  # type: ignore[attr-defined]


def use_sim_time(node: GuardedNode) -> bool:
    """Whether the node lives in simulated time."""
    parameter: Parameter = node.get_parameter("use_sim_time")
    return bool(parameter.value)

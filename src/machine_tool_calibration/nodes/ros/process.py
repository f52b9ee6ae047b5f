# SPDX-License-Identifier: Apache-2.0
"""The frame of every node's process: parameters, start, spin, and a clean stop on SIGINT and SIGTERM."""

from __future__ import annotations

import faulthandler
import json
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.shared import shared_file
from machine_tool_calibration.nodes.usage import usage

__all__ = ["STOP_GRACE", "default_environment", "post", "run", "run_here", "run_process", "say_unknown_parameters"]


Node = TypeVar("Node", bound=GuardedNode)

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
    node: GuardedNode | None = None
    executor = None
    status = 0
    try:
        node = _made(create, args)
        say_unknown_parameters(node)
        executor = EventsExecutor()
        executor.add_node(node)
        node._post = executor.create_task
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


def _made(create: Callable[[], Node], args: list[str] | None) -> Node:
    """A node, in a context of its own.

    Raises:
        CalibrationError: as `create`, or what is below rclpy refuses: arguments that it cannot read, a file of
            parameters that is not there, a domain that cannot be.
    """
    set_logger_level("rcl", LoggingSeverity.FATAL)  # which would say besides that it refuses something
    try:
        # rclpy's own handlers end the context while callbacks run; without them the loop of `run` finishes first
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level("rcl", LoggingSeverity.UNSET)
        return create()
    except (_rclpy.RCLError, _rclpy.UnknownROSArgsError, NameValidationException) as error:
        raise CalibrationError(re.sub(r", at /\S+:\d+", "", str(error))) from error


def run_here(create: Callable[[], Node], parameters: Mapping[str, Any], rules: Iterable[str] = ()) -> Node:
    """Run a node in this process until it ends or is interrupted, and return it.

    Args:
        create: makes it.
        parameters: of the node, by name.
        rules: for names of topics and the namespace, `FROM:=TO`.

    Raises:
        CalibrationError: it cannot start.
    """
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]  # which is YAML as well
    for rule in rules:
        arguments += ["-r", rule]
    made: list[Node] = []
    refused: list[CalibrationError] = []

    def created() -> Node:
        try:
            made.append(create())
        except CalibrationError as error:
            refused.append(error)  # to be said once, by the caller
            raise ExternalShutdownException from None
        return made[0]

    status = run(created, arguments)
    if refused:
        raise refused[0]
    if status or not made:
        raise CalibrationError("the node did not start")
    return made[0]


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
    node._post(node.guarded(function))

# SPDX-License-Identifier: Apache-2.0
"""The frame of every node's process: parameters, start, spin, and a clean stop on SIGINT and SIGTERM."""

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
from typing import Any, TypeVar

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.node import GuardedNode, ManagedNode
from machine_tool_calibration.nodes.shared import shared_file

Node = TypeVar("Node", bound=ManagedNode)

STOP_GRACE = 1.8  # s: nodes that have nothing to save end within 2 s, whatever happens
SAVE_GRACE = 30.0  # s: others may have a disk to wait for
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


def run(create: Callable[[], Node], args: list[str], *, grace: float = STOP_GRACE) -> int:
    """Run a node until SIGINT, SIGTERM or an external shutdown, or until it has nothing more to do.

    It is created after rclpy is up, by `args`, the program's name first. One that has not ended `grace` s after the
    signal is ended by force. Exit status: 0 stopped as asked, 1 it could not start (one line on standard error).
    """
    try:
        _run(create, args, grace)
    except (CalibrationError, ParameterException) as error:
        print(f"{args[0]}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    return 0


def _run(create: Callable[[], Node], args: list[str], grace: float) -> Node:
    default_environment()
    stop = threading.Event()
    # A thread waits for the signals: it can end the process even where the middleware holds the main thread.
    # Threads started from here on, the middleware's own, inherit the mask.
    # A signal that a thread from before takes (BLAS, a timer) comes to these handlers instead.
    for number in _STOPS:
        signal.signal(number, lambda *_: stop.set())
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    threading.Thread(target=_await_stop, args=(stop, grace), name="signals", daemon=True).start()
    node: Node | None = None
    try:
        node = _made(create, args)
        if node.autostart:
            node.start()
        _spin(node, stop)
        return node
    finally:
        if node is not None:
            if not node.done or node.is_configured:
                node.trigger_shutdown()
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()


def _spin(node: ManagedNode, stop: threading.Event) -> None:
    """Handle what comes; what the handler of an event, or the middleware, raises is logged and ends nothing."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop.is_set() and rclpy.ok() and not node.done:
        try:
            executor.spin_once(timeout_sec=_TICK)
        except (ExternalShutdownException, ShutdownException):
            break
        except Exception as error:
            node.note_fault("a callback", error)
    executor.shutdown()


def _made(create: Callable[[], Node], args: list[str]) -> Node:
    """A node in a context of its own; CalibrationError also for what is refused below rclpy."""
    set_logger_level("rcl", LoggingSeverity.FATAL)  # which would say besides that it refuses something
    try:
        # rclpy's own handlers end the context while callbacks run; without them the loop of `run` finishes first
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level("rcl", LoggingSeverity.UNSET)
        return create()
    except (RuntimeError, NameValidationException) as error:  # rclpy's own have no public name
        raise CalibrationError(re.sub(r", at /\S+:\d+", "", str(error))) from error


def run_here(create: Callable[[], Node], parameters: Mapping[str, Any], rules: Iterable[str] = ()) -> Node:
    """Run a node here to its end, and return it; `rules` are names' `FROM:=TO`. A CalibrationError: it cannot start."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]  # which is YAML as well
    for rule in rules:
        arguments += ["-r", rule]
    try:
        return _run(create, arguments, SAVE_GRACE)
    except ParameterException as error:
        raise CalibrationError(str(error)) from error


def _await_stop(stop: threading.Event, grace: float) -> None:
    """Set the event at the first signal; end the process where that does not help."""
    signal.sigwait(_STOPS)
    stop.set()
    time.sleep(grace)
    faulthandler.dump_traceback(all_threads=True)
    print(f"not ended {grace:g} s after the signal: ended by force", file=sys.stderr, flush=True)
    os._exit(1)


def post(node: GuardedNode, function: Callable[[], None]) -> None:
    """Have a function called in the node's own thread, from any thread; an exception in it is logged."""
    node.executor.create_task(node.guarded(function))

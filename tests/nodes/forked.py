# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own that need not import anything: forked from one that has imported all nodes.

An import takes a node longer than most tests do. From there on a node is as `python -m` starts it: its own session,
log, environment, arguments, middleware and exit status. Started as a program this file is the process that forks; its
argument is the name by which it is asked.
"""

import gc
import inspect
import os
import re
import signal
import subprocess
import sys
import traceback
from functools import cache
from importlib import import_module
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path

from machine_tool_calibration.nodes.__main__ import NODES, main
from machine_tool_calibration.nodes.graph import Graph, end_with_parent
from machine_tool_calibration.nodes.ros import process as frame
from machine_tool_calibration.recording.cdr import typestore

# s: as long as a slow and busy machine may take for anything that needs no time of its own; reached only in a failure
PATIENCE = 300.0
# s after a signal until a node ends by force, in place of the two seconds of use: only one that hangs takes so long
GRACE = 60.0


class Forked:
    """A node's process, with what a graph asks of a `subprocess.Popen`."""

    def __init__(self, command: list[str], environment: dict[str, str], log: Path) -> None:
        self.args = command
        self.returncode: int | None = None
        self._keeper = Client(address(), "AF_UNIX")
        self._keeper.send((command, environment, str(log.absolute()), os.getcwd()))
        self.pid = self._keeper.recv()

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            if not self._keeper.poll(timeout):
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            self.returncode = self._keeper.recv()
            self._keeper.close()
        return self.returncode

    def poll(self) -> int | None:
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class ForkedGraph(Graph):
    """A graph whose nodes are forked."""

    def _launch(self, command, environment, log):
        return Forked(command, environment, log)

    def ends(self, name, number):
        """Whether a node ends by itself at a signal, and not by force; a hang of the middleware is none of its own."""
        process = self._running.pop(name)
        process.send_signal(number)
        status = process.wait(PATIENCE)
        return status == 0 or (status == 1 and held_by_the_middleware(self.folder / f"{name}.log"))


def held_by_the_middleware(log):
    """Whether a node that was ended by force was in a call of rclpy, by the traces of its threads."""
    *_, main = re.split(r"^.*hread 0x.*$", log.read_text(), flags=re.MULTILINE)
    return "ended by force" in main and "/rclpy/" in main.strip().partition("\n")[0]


@cache
def address() -> str:
    """Where the process that forks is asked; it ends with this one."""
    name = f"mtcal-forked-{os.getpid()}"
    process = subprocess.Popen(
        [sys.executable, __file__, name],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)},
        preexec_fn=end_with_parent,
    )
    assert process.stdout is not None and process.stdout.read(5) == b"ready"
    return "\0" + name  # no file: it goes with the process


def serve(name: str) -> None:
    for node in NODES:
        import_module(f"machine_tool_calibration.nodes.{node}")
    typestore()
    frame.STOP_GRACE = frame.SAVE_GRACE = GRACE
    # rclpy looks through all modules when a process writes its first line into the log.
    inspect.getmodule(inspect.currentframe())
    gc.freeze()  # no node looks for circles in what they share
    with Listener("\0" + name, "AF_UNIX", backlog=20) as listener:
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # who keeps a node needs no keeper
        os.write(1, b"ready")
        while True:
            asked = listener.accept()
            if not os.fork():
                keep(asked)
            asked.close()


def keep(asked: Connection) -> None:
    """Start a node, and tell its number and its exit status."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    end_with_parent()
    asked_for = asked.recv()
    node = os.fork()
    if not node:
        begin(*asked_for)
    asked.send(node)
    asked.send(os.waitstatus_to_exitcode(os.waitpid(node, 0)[1]))
    os._exit(0)


def begin(command: list[str], environment: dict[str, str], log: str, folder: str) -> None:
    """Be the node that `python -m` would be."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    end_with_parent()
    os.setsid()
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    try:
        os._exit(main(command[3], command[4:]))
    except BaseException:
        traceback.print_exc()
    os._exit(1)


if __name__ == "__main__":
    serve(sys.argv[1])

# SPDX-License-Identifier: Apache-2.0
"""What starts a graph: processes that are watched and ended where there is no `ros2 launch`, and what its files share.

Launch files need parameters of the nodes, arguments that are checked before anything is started, and managed nodes.
"""

import ctypes
import errno
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import yaml

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.nodes.ros.process import default_environment
from machine_tool_calibration.session.catalogue import method_spec

LISTENERS = ("estimator", "recorder")
"""Nodes that only listen: where one ends the measurement goes on, and it is started again."""
COULD_NOT_START = 1
"""Exit status of a node that could not start (`nodes.ros.process.run`): it could not a second time."""
LISTENER_STARTS = 4
"""Of one of these; more do not help it."""
_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG
_POLL = 0.02  # s
_STAMP = re.compile(r"^\[\w+\] \[[\d.]+\] \[[^]]*\]: ")  # before what a node's log says
_GRACE = 3.0  # s in which a node ends by itself after SIGINT
_CLOSE = 40.0  # longer than the recorder gives itself to close its file


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Ctrl-C comes when this is over: an exception in what Python calls when a process forks is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = list[int]()
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        for number in pressed[:1]:
            signal.raise_signal(number)


Parameters = Mapping[str, Mapping[str, Any]]
"""Of nodes, by the executable's name, which is also the node's."""


class Graph:
    """The processes of one graph, as a context; leaving it ends them all.

    `nodes` are started with these parameters; the ROS parameter file of the user's own counts more. Logs and parameter
    files are in the folder.
    """

    def __init__(
        self, nodes: Parameters, folder: Path, domain: int, namespace: str = "", parameters: Path | None = None
    ) -> None:
        self._nodes = dict(nodes)
        self.folder, self._domain, self._parameters = folder, domain, parameters
        self.namespace = "/" + namespace.strip("/") if namespace.strip("/") else ""
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            for name in self._nodes:
                self.start(name)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, **changed: Any) -> None:
        """Start one node, or start it again, with parameters that differ from the first time's."""
        values = self._nodes[name] = {**self._nodes[name], **changed}
        parameters = self.folder / f"{name}.yaml"
        content = {"/**": {"ros__parameters": values}}
        parameters.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        command = [sys.executable, "-m", "machine_tool_calibration.nodes", name, "--ros-args"]
        command += ["--params-file", str(parameters)]
        if self._parameters is not None:
            command += ["--params-file", str(self._parameters)]
        if self.namespace:  # /clock is absolute: without this two graphs would share one clock
            command += ["-r", f"__ns:={self.namespace}", "-r", f"/clock:={self.namespace}/clock"]
        default_environment()
        # small matrices and several processes: more threads only get in each other's way
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self._domain), "OMP_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(entry for entry in sys.path if entry)
        with (self.folder / f"{name}.log").open("ab") as file, _interrupted_later():
            self._running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env=environment,
                start_new_session=True,  # Ctrl+C reaches this process only, which then ends the others in order
                preexec_fn=end_with_parent if sys.platform == "linux" else None,
            )

    def ended(self) -> dict[str, str]:
        """Nodes that have ended by themselves, with their status and the last line of their log."""
        return {
            name: f"{name} {_ending(status)}{self._last_line(name)}"
            for name, process in self._running.items()
            if (status := process.poll()) is not None
        }

    def check(self) -> None:
        """A CalibrationError, with the last line of its log, if a node has ended by itself."""
        for why in self.ended().values():
            raise CalibrationError(why)

    def process_id(self, name: str) -> int:
        """Of a running node."""
        return self._running[name].pid

    def kill(self, name: str, number: int = signal.SIGKILL) -> int:
        """End one node by a signal, and give its exit status."""
        process = self._running.pop(name)
        process.send_signal(number)
        return _ended(process, 10.0)

    def stop(self, names: Sequence[str] | None = None) -> None:
        """End nodes, all by default: SIGINT, and SIGKILL for one that takes longer than its grace."""
        chosen = [name for name in (names or list(self._running)) if name in self._running]
        for name in chosen:
            if self._running[name].poll() is None:
                self._running[name].send_signal(signal.SIGINT)
        begin = time.monotonic()
        for name in chosen:
            grace = _CLOSE if name == "recorder" else _GRACE
            _ended(self._running.pop(name), max(begin + grace - time.monotonic(), _POLL))

    def _last_line(self, name: str) -> str:
        """The last line of its log that says more than what it does, after a colon; nothing where there is none."""
        log = (self.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
        told = [line.strip() for line in log if line.strip() and not line.startswith(("[INFO]", "[DEBUG]"))]
        return f": {_STAMP.sub('', told[-1])}" if told else ""


def _ending(status: int) -> str:
    return f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"


def _ended(process: subprocess.Popen[bytes], grace: float) -> int:
    """The exit status of a process that has to end by itself within a time, s, or is killed."""
    try:
        return process.wait(timeout=grace)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def end_with_parent() -> None:
    """In the child: end when the starter is killed, so that nothing stays behind."""
    ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGTERM)


_WORDS = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}


def switches(given: Mapping[str, str], names: Collection[str]) -> dict[str, bool]:
    """The arguments of these names, which are true or false; raises CalibrationError where one is neither."""
    for name in names:
        if given[name].lower() not in _WORDS:
            raise CalibrationError(f"{name}:={given[name]} is neither true nor false")
    return {name: _WORDS[given[name].lower()] for name in names}


def refuse_unknown(file: str, given: Collection[str], known: Collection[str]) -> None:
    """Refuse arguments nobody reads, which `ros2 launch` passes over, unless another launch file includes this one."""
    unknown = sorted(set(given) - set(known))
    if unknown and any(word.endswith(file) for word in sys.argv):
        name = unknown[0]
        raise CalibrationError(f"there is no argument {name!r}{did_you_mean(name, known)}; {file} --show-args has them")


def graph_parameters(
    method: str, procedure: Path | str, site: Path | str, *, simulated_time: bool, driver: str, bag: Path | str
) -> dict[str, dict[str, Any]]:
    """Parameters of the nodes that a measurement needs, by their names.

    A probe is instrument and pointer in one, a fixed beam needs no pointer. `site` is the file of what is true in the
    simulated workshop; with simulated time they live by `/clock`. An empty `bag` is one named by the date. A
    CalibrationError: there is no such driver's file, or it has to live in simulated time.
    """
    if driver != "simulated":
        if not Path(driver).is_file():
            raise CalibrationError(f"driver: {driver}: no such file")
        if simulated_time:
            raise CalibrationError("driver: a real driver needs real time: use_sim_time must be false")
    common = {"use_sim_time": simulated_time}
    # one origin for all simulating nodes, whole seconds so that it is exact
    world = {**common, "site": str(site), "time_origin": float(int(time.time()))}
    spec = method_spec(method)
    without = {"rotary_pointer", "instrument"} if spec.probes_surface else {"probe"}
    without |= set() if spec.beam_from_pointer else {"rotary_pointer"}
    every: dict[str, dict[str, Any]] = {
        "axis_simulator": world,
        "rotary_pointer": world,
        "instrument": {**world, "driver": driver},
        "probe": world,
        "estimator": {**common},
        "procedure": {**common, "procedure": str(procedure)},
        "recorder": {**common, "folder": str(bag)},
    }
    return {name: values for name, values in every.items() if name not in without}


def managed_nodes(
    parameters: Parameters, namespace: str, file: str, on_exit: Callable[..., Any] | None = None, *, autostart: bool
) -> list[Any]:
    """The actions that start nodes of this package; one that only listens is started again where it fails.

    These parameters count more than those of the file (a CalibrationError where it is not there). `/clock`
    is remapped into the namespace: it is absolute, and two graphs would share it. `on_exit` is called when one ends
    that does not only listen. With `autostart` they configure and activate themselves, which a parameter tells them: a
    transition that `launch` asks for is lost, now and then, where the node has not discovered it yet.
    """
    from launch.actions import LogInfo
    from launch_ros.actions import LifecycleNode

    if not Path(file).is_file():  # `launch_ros` would go on without it
        raise CalibrationError(f"params_file: {file}: no such file")
    space = namespace.strip("/")

    def node(name: str, values: Mapping[str, Any], on_exit: Callable[..., Any] | None) -> Any:
        return LifecycleNode(
            package="machine_tool_calibration",
            executable=name,
            name=name,
            namespace=space,
            parameters=[file, {**values, "autostart": autostart}],
            remappings=[("/clock", f"/{space}/clock")] if space else [],
            output="screen",
            on_exit=on_exit,
        )

    def listener(name: str, start: int = 1) -> Any:
        def ends(event: Any, context: Any) -> Any:
            if context.is_shutdown:
                return None
            why = f"{name} has ended (status {event.returncode}); the other nodes go on"
            if event.returncode in (0, COULD_NOT_START) or start == LISTENER_STARTS:
                return LogInfo(msg=f"{why} without it")
            whole = "; `mtcal recover` makes the bag so far whole" if name == "recorder" else ""
            return [LogInfo(msg=f"{why}, it is started again and gets all readings{whole}"), listener(name, start + 1)]

        values = dict(parameters[name])
        if start > 1 and values.get("folder"):  # of a recording: that of before stays as it is
            values["folder"] += f"_{start}"
        return node(name, values, ends)

    return [listener(name) if name in LISTENERS else node(name, values, on_exit) for name, values in parameters.items()]


_IDS = range(0, 102)  # larger ones need ports that the system gives to outgoing connections


@contextmanager
def claimed_domain(wanted: int | None = None, namespace: str = "") -> Iterator[int]:
    """A domain id for a measurement, kept from others for as long as the context lasts.

    The one that is wanted, where no other measurement of this machine is in the same namespace; by default the user's
    ROS_DOMAIN_ID, and else the first that no other has claimed. A CalibrationError: not a domain id, or none is free.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID", "") if wanted is None else str(wanted)
    if chosen:
        if not chosen.isdigit() or int(chosen) > 232:
            raise CalibrationError(f"ROS domain id {chosen!r} is not a whole number from 0 to 232")
        space = f"/{namespace.strip('/')}"
        if (claim := _claim(f"{int(chosen)}{space}")) is None:
            raise CalibrationError(
                f"another measurement is running in ROS domain {int(chosen)}, namespace {space}: both would move the "
                "same axes; --domain-id or --namespace keeps them apart"
            )
        with claim:
            yield int(chosen)
        return
    with free_domain() as domain:
        yield domain


@contextmanager
def free_domain(ids: Iterable[int] = _IDS) -> Iterator[int]:
    """The first of these ids that nobody here has claimed, while this lasts; a CalibrationError: none is free."""
    for domain in ids:
        if (claim := _claim(str(domain))) is not None:
            with claim:
                yield domain
            return
    raise CalibrationError("no ROS domain id is free on this machine; --domain-id chooses one")


def _claim(domain: str) -> socket.socket | None:
    """A socket that holds a name which only one program can hold; None if another has it.

    The name is in the kernel: it is the same for every user, reaches as far as the network on which graphs would meet
    (a container has names of its own), and goes with its program. A CalibrationError: the system gives no such name.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0machine_tool_calibration/domain/{domain}")
    except OSError as error:
        claim.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise CalibrationError(f"no ROS domain id can be claimed here ({error}); --domain-id chooses one") from error
    return claim

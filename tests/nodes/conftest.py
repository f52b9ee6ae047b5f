# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="the graph needs ROS 2")

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.session.session import Session

from .forked import PATIENCE, ForkedGraph
from .publishing import publish

# s: for a whole procedure
WHOLE = 900.0
ORIGIN = 1_700_000_000.0

PROCEDURE = {
    "format": "mtcal-procedure/1",
    "name": "small",
    "session": {
        "method": "tracking_interferometer",
        "dimension": 2,
        "pointing": "open_loop",
        "machine": {"chain": "w-C-b-Y-X-Z-t", "travel": {"x": [0.0, 0.4], "y": [0.0, 0.4], "z": [0.0, 0.05]}},
        "repeats": 2,
        "setups": [
            {"id": "A", "position": [-0.35, 0.05, 0.0]},
            {"id": "B", "position": [0.15, -0.4, 0.0]},
            {"id": "C", "position": [0.7, 0.3, 0.0]},
            {"id": "D", "position": [0.1, 0.85, 0.0]},
        ],
        "standard_uncertainty": {"displacement": 3.0e-7},
    },
    "path": {
        "grid": {
            "x": {"first": 0.02, "last": 0.38, "count": 3},
            "y": {"first": 0.02, "last": 0.38, "count": 3},
            "z": [0.0],
        }
    },
    "motion": {"speed": {"x": 0.4, "y": 0.4}, "acceleration": {"x": 2.0, "y": 2.0}, "dwell": 0.5},
}

SITE = {
    "seed": 5,
    "noise": 0.0,
    "station_uncertainty": 0.0,
    "machine": {"chain": "w-C-b-Y-X-Z-t", "travel": {"x": [0.0, 0.4], "y": [0.0, 0.4], "z": [0.0, 0.05]}, "seed": 77},
}


class Bench:
    """Starts graphs in simulated time for a test and ends them all."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder, self.domain = folder, domain
        self.stack = ExitStack()
        self.count = 0

    def write(self, name: str, content: object) -> str:
        path = self.folder / name
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return str(path)

    def graph(
        self,
        names: tuple[str, ...] = ("axis_simulator", "rotary_pointer", "instrument", "procedure"),
        *,
        procedure: object = PROCEDURE,
        site: object = SITE,
        namespace: str = "",
        simulated_time: bool = True,
        more: dict[str, dict[str, object]] | None = None,
    ) -> ForkedGraph:
        self.count += 1
        site_file = self.write(f"site{self.count}.yaml", site)
        world = {"use_sim_time": simulated_time, "site": site_file, "time_origin": ORIGIN if simulated_time else 0.0}
        file = self.write(f"procedure{self.count}.yaml", procedure)
        parameters: dict[str, dict[str, object]] = {
            "axis_simulator": world,
            "rotary_pointer": world,
            "instrument": {**world, "sample_noise": 0.0},
            "procedure": {"use_sim_time": simulated_time, "procedure": file, "patience": PATIENCE},
            "estimator": {"use_sim_time": simulated_time},
            "recorder": {"use_sim_time": simulated_time, "folder": str(self.folder / f"bag{self.count}")},
        }
        given = {name: {**parameters[name], **(more or {}).get(name, {})} for name in names}
        # None: the node's own default
        nodes = {name: {key: value for key, value in own.items() if value is not None} for name, own in given.items()}
        folder = self.folder / f"log{self.count}"
        return self.stack.enter_context(ForkedGraph(nodes, folder, self.domain, namespace))

    def operator(self, graph: ForkedGraph | None = None, namespace: str = "") -> Client:
        space = graph.namespace if graph is not None else namespace
        return self.stack.enter_context(Client(self.domain, space))


@pytest.fixture
def bench(tmp_path: Path, ros_domain: int) -> Iterator[Bench]:
    made = Bench(tmp_path, ros_domain)
    with made.stack:
        yield made


@pytest.fixture
def finish() -> Callable[[Client], None]:
    """Start the procedure as soon as it is ready and wait for its end."""

    def run(operator: Client) -> None:
        begin(operator)
        ended(operator)
        total = operator.procedure.number("total")
        assert operator.wait(lambda: len(operator.heard.session()[1]) >= total, PATIENCE)

    return run


def begin(operator: Client) -> None:
    assert operator.wait(
        lambda: operator.procedure.entries.get("state") == "idle" and not operator.procedure.entries["waiting_for"],
        PATIENCE,
    ), operator.procedure
    operator.call("procedure/start", PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries["state"] != "idle", PATIENCE)


def ended(operator: Client) -> None:
    """Wait until the procedure ends, which must be as it should."""
    assert operator.wait(lambda: operator.procedure.entries["state"] != "running", WHOLE), operator.procedure
    assert operator.procedure.entries["state"] == "finished", operator.procedure


def resumed(operator: Client, until: Callable[[], bool]) -> None:
    """Wait until something holds, and resume where a partner took longer than the patience that a test has set.

    A partner that is there may do so where others keep the machine busy.
    """

    def there() -> bool:
        if until():
            return True
        if operator.procedure.entries["state"] == "error":
            with suppress(CalibrationError):  # it goes on already
                operator.call("procedure/resume", PATIENCE)
            operator.wait(lambda: operator.procedure.entries["state"] != "error", 1.0)
        return False

    assert operator.wait(there, WHOLE), operator.procedure


def ask(operator: Client, kind: Any, service: str, request: Any) -> Any:
    """A service's response, asked for again until it comes; only for requests that may be repeated.

    An answer is lost where the server does not know its client yet.
    """
    client = operator.client(service, kind)  # kept: the server may know it the next time
    assert operator.wait(client.service_is_ready, PATIENCE), service
    asked: list[Any] = []

    def answer() -> bool:
        asked.append(client.call_async(request))
        return bool(operator.wait(lambda: any(one.done() for one in asked), 1.0))

    assert operator.wait(answer, PATIENCE), f"{service} does not answer"
    return next(one.result() for one in asked if one.done())


def feed(operator: Client, session: Session, start: int = round(ORIGIN * 1e9)) -> None:
    """Publish a session as the procedure does, latched, and wait until the estimator has it."""
    publish(operator.node, session, start)
    collected(operator, len(session.readings))


def collected(operator: Client, count: int) -> None:
    """Wait until the estimator has so many readings, and the description, which may come later than they."""

    def there() -> bool:
        status = operator.heard.said("estimator")
        return status.number("readings") == count and status.entries["session"] == "described"

    assert operator.wait(there, PATIENCE), operator.heard.said("estimator")

# SPDX-License-Identifier: Apache-2.0
"""A whole measurement: start the graph, run a procedure, record, identify, end, and say where everything is."""

import json
import operator
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from machine_tool_calibration.budget.enough import Reached, Until, determined, reached
from machine_tool_calibration.effects.catalogue import find_effects, own_effects
from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.files import save
from machine_tool_calibration.methods.build import model_of
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.nodes.graph import LISTENER_STARTS, LISTENERS, Graph, claimed_domain, graph_parameters
from machine_tool_calibration.nodes.ros.messages import Level, StatusTopic
from machine_tool_calibration.nodes.ros.node import OF_ROS, parameters_of
from machine_tool_calibration.planning.forecast import planned_session
from machine_tool_calibration.procedure import Procedure, plan, read_procedure
from machine_tool_calibration.procedure.events import COUNTERS
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.collect import live_session
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.text import read_yaml, yaml_text
from machine_tool_calibration.simulation.site import SiteSpec

NODES = ("axis_simulator", "rotary_pointer", "instrument", "probe", "estimator", "procedure", "recorder")
_START = 120.0  # s until all nodes have found each other, on a slow machine
_IDENTIFY = 600.0
_DISCOVERED = 1.0  # s after which nodes that were there before are known
_FORGOTTEN = 25.0  # s after which one that was killed no longer is
_GONE = 5.0  # s; discovery forgets a node that was killed after some 20 s, and may blink
# what takes no time, on a machine that has none: reached only in a failure
_COLLECT = 60.0
_ANSWER = 60.0
_ON_THE_WAY = 5.0
_LONGEST = 40  # readings of a stage: a minute or two

Counting = Callable[[str, int, int], None]
"""Called with what is going on, without their number, and how many of how many readings there are."""


@dataclass(frozen=True)
class Setting:
    """How a measurement is run."""

    output: Path  # folder for everything that is written; must be free
    # what is true in the simulated workshop; its machine's chain and travel come from the procedure
    site: SiteSpec = field(default_factory=SiteSpec)
    simulated_time: bool = True  # run as fast as the machine can, instead of in real time
    driver: str = "simulated"  # `simulated`, or the YAML file of a real instrument's driver
    namespace: str = ""  # of the graph
    domain: int | None = None  # ROS domain id; a free one by default
    record: bool = True  # whether the recorder runs
    identify: bool = True  # whether the errors are identified at the end
    model: str | None = None  # variant of the model; None: the default
    effects: tuple[str, ...] = ()  # effects added to the model
    external: tuple[str, ...] = ()  # nodes that run elsewhere and are not started
    parameters: Path | None = None  # a ROS parameter file for the nodes
    # what is to be reached; the measurement ends with the setup after which it is. All of the procedure if absent
    until: Until | None = None


@dataclass(frozen=True)
class Measured:
    """What a measurement has left."""

    output: Path  # folder of everything
    session: Session  # what was measured
    bag: Path | None  # the recording, if there is one
    result: dict[str, Any] | None  # the result document, if the errors were identified
    seconds: tuple[float, float]  # from the start of the graph, and of the procedure alone
    counters: dict[str, int]  # what did not go straight, by name
    remarks: tuple[str, ...]  # a sentence for each time that a node that only listens ended and was started again
    reached: tuple[Reached, ...] = ()  # after each setup what was known, where something was to be reached

    @property
    def session_folder(self) -> Path:
        """The session as files."""
        return self.output / "session"


class _Listeners:
    """Watches the graph: a node that only listens is started again when it ends, any other ends the measurement."""

    def __init__(self, graph: Graph, output: Path, tell: Callable[[str], None]) -> None:
        self._graph, self._output, self._tell = graph, output, tell
        self.bag = output / "bag"  # the recorder's, or that of the one that was started last
        self.client: Client | None = None
        self.remarks: list[str] = []  # what was missed, a sentence for each time

    def watch(self) -> None:
        """Look after the processes. A CalibrationError: one has ended that the measurement cannot do without."""
        for name, why in self._graph.ended().items():
            if name not in LISTENERS or self.client is None:
                raise CalibrationError(why)
            again = sum(remark.startswith(name) for remark in self.remarks) + 2
            if again > LISTENER_STARTS:
                self._remark(f"{why}; it is not started again")
                self._graph.kill(name)
                continue
            count = self.client.heard.count[1]
            if name == "recorder":
                before, self.bag = self.bag, self._output / f"bag_{again}"
                found = f"{self.bag} has all readings, and the other topics from there on"
                whole = f"`mtcal recover {before}` makes what came before whole"
                self._remark(f"{why} after {count} readings; {found}; {whole}")
                self._graph.start(name, folder=str(self.bag.resolve()))
            else:
                self._remark(f"{why} after {count} readings; it gets them all again")
                self._graph.start(name)

    def _remark(self, text: str) -> None:
        self.remarks.append(text)
        self._tell(text)


def free_folder(name: str, given: Path | None) -> Path:
    """The output's folder: the one given, or `mtcal_output/<name>` numbered; a CalibrationError: it holds something."""
    if given is not None:
        if given.exists() and (not given.is_dir() or any(given.iterdir())):
            raise CalibrationError(f"{given}: is there already; choose another output folder")
        return given
    for number in range(1, 100_000):
        folder = Path("mtcal_output", name if number == 1 else f"{name}-{number}")
        if not folder.exists():
            return folder
    raise CalibrationError("mtcal_output: holds too many measurements")


def measure(
    file: Path,
    setting: Setting,
    progress: Counting = lambda text, done, total: None,
    tell: Callable[[str], None] = lambda text: None,
) -> Measured:
    """Run a procedure from the first process to the last file; `tell` is told at once what is missed meanwhile.

    A CalibrationError: the procedure or the setting is wrong, a node does not start or ends, or the procedure ends in
    an error; what was measured until then stays in the output folder.
    """
    procedure = read_procedure(file)
    _require_possible(setting, procedure)
    output, total = setting.output, len(plan(procedure).steps)
    nodes, begin = _nodes(setting, procedure), time.monotonic()
    for remark in _misspelt(setting.parameters, nodes):
        tell(remark)
    with claimed_domain(setting.domain, setting.namespace) as domain:
        graph = Graph(nodes, output / "log", domain, setting.namespace, setting.parameters)
        listeners = _Listeners(graph, output, tell)
        with Client(domain, graph.namespace, watch=listeners.watch) as client:
            _refuse_company(client, list(nodes), domain)
            output.mkdir(parents=True, exist_ok=True)
            copy, site = _inputs(output)
            shutil.copyfile(file, copy)
            site.write_text(yaml_text(site_document(procedure, setting.site)), encoding="utf-8")
            progress("starting the nodes", 0, total)
            with graph, _keeping(client, listeners, output, total):
                _await_ready(client, list(nodes))
                listeners.client = client
                started = time.monotonic()
                stages = None if setting.until is None else Stages(client, procedure, setting, setting.until)
                _run(client, total, progress, stages)
                measured = time.monotonic() - started
                captured = client.procedure.number("captured")
                document = _identify(client, listeners, captured, progress) if setting.identify else None
                progress("closing the recording", captured, captured)
                graph.stop(["recorder"])
            if (session := _save(client, output)) is None:
                raise CalibrationError("the procedure ended without a reading")
            counters = {name: client.procedure.number(name) for name in COUNTERS}
    if document is not None:
        save(output / "result.json", json.dumps(document, allow_nan=False, indent=1))
    return Measured(
        output=output,
        session=session,
        bag=listeners.bag if listeners.bag.exists() else None,
        result=document,
        seconds=(time.monotonic() - begin, measured),
        counters=counters,
        remarks=tuple(listeners.remarks),
        reached=() if stages is None else tuple(stages.reached),
    )


def _require_possible(setting: Setting, procedure: Procedure) -> None:
    """Refuse, before anything moves, what could not be started or identified; a CalibrationError says what."""
    if setting.parameters is not None and not setting.parameters.is_file():
        raise CalibrationError(f"{setting.parameters}: no such file")
    if setting.identify:
        model_of(procedure.session.method, setting.model)
        if setting.parameters is None:  # which may name files of the user's own effects
            find_effects(setting.effects)


def _misspelt(parameters: Path | None, nodes: Collection[str]) -> Iterator[str]:
    """Names in a parameter file that are hardly those of other nodes, and parameters that a node does not have."""
    content = None if parameters is None else read_yaml(parameters).value
    for key, own in content.items() if isinstance(content, dict) else ():
        name = key.rsplit("/", 1)[-1]
        if name in nodes and isinstance(own, dict):
            known = (*parameters_of(name), *OF_ROS, "qos_overrides")
            odd = (one for one in map(str, own.get("ros__parameters") or ()) if one.split(".")[0] not in known)
            yield from (f"{parameters}: {name} has no parameter {one!r}{did_you_mean(one, known)}" for one in odd)
        elif name not in nodes and (hint := did_you_mean(name, nodes)):
            yield f"{parameters}: no node {name!r} is started{hint}"


@contextmanager
def _keeping(client: Client, listeners: _Listeners, output: Path, total: int) -> Iterator[None]:
    """Whatever ends the measurement says where its readings are, and what was missed."""
    try:
        yield
    except (KeyboardInterrupt, CalibrationError) as error:
        # those that the procedure has told of may still be on their way
        client.wait(lambda: client.heard.count[1] >= client.procedure.number("captured"), _ON_THE_WAY, watched=False)
        if (kept := _save(client, output)) is None:
            raise
        where = f"{len(kept.readings)} of {total} readings are kept in {output / 'session'}"
        raise type(error)("; ".join((str(error) or "interrupted", where, *listeners.remarks))) from error


def site_document(procedure: Procedure, site: SiteSpec) -> dict[str, Any]:
    """The content of a site's file that suits a procedure: its machine's chain and travel, its declared noise."""
    document = site.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    machine = procedure.session.machine
    travel = {name: list(ends) for name, ends in machine.travel.items()}
    own: dict[str, Any] = {"chain": machine.chain, "travel": travel}
    if (sign := getattr(procedure.session, "rotation_sign", None) or machine.rotation_sign) is not None:
        own["rotation_sign"] = sign
    document["machine"] = {**own, **document.get("machine", {})}
    noise = procedure.session.standard_uncertainty.displacement
    return {"seed": site.seed, "noise": noise, **document}


def _inputs(output: Path) -> tuple[Path, Path]:
    """Procedure and site as the nodes read them."""
    return output / "procedure.yaml", output / "site.yaml"


def _nodes(setting: Setting, procedure: Procedure) -> dict[str, dict[str, Any]]:
    copy, site = _inputs(setting.output)
    method, bag = procedure.session.method, (setting.output / "bag").resolve()
    parameters = graph_parameters(
        method, copy.resolve(), site.resolve(), simulated_time=setting.simulated_time, driver=setting.driver, bag=bag
    )
    parameters["estimator"] |= {"model": setting.model or "", "effects": list(setting.effects) or [""]}
    if setting.until is not None:
        parameters["procedure"] |= {"wait_between_setups": True, "wait_every": stage_of(procedure)}
    nodes = tuple(name for name in NODES if name in parameters)
    for name in setting.external:
        if name not in nodes:
            raise CalibrationError(f"{name!r} is not a node of the graph; these are {', '.join(nodes)}")
    optional = {"recorder": setting.record, "estimator": setting.identify}
    left_out = {*setting.external, *(name for name, wanted in optional.items() if not wanted)}
    first = sorted(nodes, key=lambda name: name != "recorder")  # which is to hear the others from their start
    return {name: parameters[name] for name in first if name not in left_out}


def _refuse_company(client: Client, names: Sequence[str], domain: int) -> None:
    """Refuse (CalibrationError) to start where nodes of these names are: both graphs would move the same axes."""

    def there() -> list[str]:
        return [name for name in names if client.has_node(name)]

    def gone() -> bool:  # what was killed is known for a while, and says nothing
        return not there() or bool(client.heard.nodes())

    if client.wait(lambda: bool(there()), _DISCOVERED):
        client.wait(gone, _FORGOTTEN)
    if others := there():
        where = f"{client.node.get_namespace().rstrip('/')}/{others[0]}"
        raise CalibrationError(
            f"another graph is in ROS domain {domain}, with {where}: both would move the same axes; end it, or "
            "--domain-id or --namespace keeps them apart"
        )


def _await_ready(client: Client, names: Sequence[str]) -> None:
    def records() -> bool:
        """Whether the recorder hears all it needs, in simulated time the clock too: later it would miss the start."""
        return "recorder" not in names or client.heard.said("recorder").entries.get("state") == "recording"

    def all_there() -> bool:
        status = client.procedure.entries
        is_ready = status.get("state") == "idle" and not status.get("waiting_for", "?")
        return is_ready and records() and all(client.has_node(name) for name in names)

    if not client.wait(all_there, _START):
        missing = [name for name in names if not client.has_node(name)]
        waiting = ", ".join(missing) or client.procedure.entries.get("waiting_for")
        waiting = waiting or ("the procedure" if records() else "the recorder")
        raise CalibrationError(f"the graph is not complete after {_START:g} s: no sign of {waiting}")


def stage_of(procedure: Procedure) -> int:
    """How many readings a stage has."""
    session = procedure.session
    repeat = len(plan(procedure).steps) / (len(session.setups) * session.repeats)
    return ceil(repeat / ceil(repeat / _LONGEST))


class Stages:
    """Decides between stages whether the measurement goes on, and says so on `until/status`.

    A stage is a repeat of a setup, or a part of one that is long. The client is beside the graph, which runs the
    procedure and pauses before every stage; `until` is what is to be reached.
    """

    def __init__(self, client: Client, procedure: Procedure, setting: Setting, until: Until) -> None:
        self._client, self._until = client, until
        self._model, self._effects, self._own = setting.model, setting.effects, tuple(own_effects(()))
        # a person takes the instrument to its setups, if it has to be taken there
        is_mounted = bool(method_spec(procedure.session.method).mounted(procedure.session))
        self._by_hand = is_mounted and not setting.simulated_time
        self._wanted = 1
        if until.u is not None:  # all that the whole procedure determines
            self._wanted = determined(FitRequest((planned_session(procedure),), None, self._model))
        self.reached: list[Reached] = []  # after each stage so far
        self._status = StatusTopic(client.node, "until", topic="until/status")

    def next(self, progress: Counting) -> None:
        """Ask for the next stage, or for the end; a person who brings the instrument to another setup resumes."""
        found, client = self.last(progress), self._client
        by_hand = self._by_hand and client.procedure.entries["setup"] != found.setup
        if found.enough:
            client.call("procedure/finish", _ANSWER)
        elif not by_hand:
            client.call("procedure/resume", _ANSWER)
        else:
            progress(client.procedure.message, found.readings, client.procedure.number("total"))

        def goes_on() -> bool:  # it may have come to the next stage meanwhile
            return client.procedure.entries["state"] != "paused" or client.procedure.number("captured") > found.readings

        if not client.wait(goes_on, float("inf") if by_hand else _ANSWER):
            raise CalibrationError("the procedure does not go on")

    def last(self, progress: Counting) -> Reached:
        """What is known after the readings so far."""
        captured, total = (self._client.procedure.number(name) for name in ("captured", "total"))
        if not self._client.wait(lambda: self._client.heard.count[1] >= captured, _ANSWER):
            raise CalibrationError(f"only {self._client.heard.count[1]} of {captured} readings were received")
        if self.reached and self.reached[-1].readings == captured:
            return self.reached[-1]
        progress("is it enough?", captured, total)
        text, readings = self._client.heard.session()
        chosen = FitRequest((live_session(text, readings, check=False),), None, self._model, self._effects, self._own)
        found = reached(chosen, self._until, self._wanted, whole=captured == total)
        self.reached.append(found)
        entries: dict[str, object] = {
            "setup": found.setup,
            "readings": found.readings,
            "U": f"{found.u:.4g}" if np.isfinite(found.u) else "",
            "wanted_U": "" if self._until.u is None else f"{self._until.u:.4g}",
            "enough": found.enough,
            **{f"probability.{name}": f"{p:.3f}" for name, p in found.probabilities.items()},
        }
        words = "enough" if found.enough else "not yet enough"
        self._status.show(Level.OK, f"{words} after setup {found.setup}", entries)
        return found


def _run(client: Client, total: int, progress: Counting, stages: Stages | None = None) -> None:
    client.call("procedure/start", _COLLECT)
    seen, begun = time.monotonic(), False

    def over() -> bool:
        nonlocal seen, begun
        if client.has_node("procedure"):
            seen = time.monotonic()
        elif time.monotonic() - seen > _GONE:  # started elsewhere: its process cannot be watched
            raise CalibrationError("the procedure has ended in the middle of the measurement")
        status = client.procedure
        state = status.entries.get("state")
        if begun and state == "idle":
            again = "the datum is lost with it, so what is missing cannot be added: run the procedure again"
            raise CalibrationError(f"the procedure was started anew in the middle of the measurement; {again}")
        begun = begun or state == "running"
        progress(state if state in ("finished", "aborted") else status.message, status.number("captured"), total)
        return state in ("finished", "error", "aborted") or (stages is not None and state == "paused")

    try:
        client.wait(over, float("inf"))
        while stages is not None and client.procedure.entries["state"] == "paused":
            stages.next(progress)
            client.wait(over, float("inf"))
    except KeyboardInterrupt:
        client.call("procedure/abort", 2.0)
        raise
    status = client.procedure
    if status.entries["state"] != "finished":
        raise CalibrationError(f"the procedure ended: {status.message}")
    total = status.number("captured")
    if not client.wait(lambda: client.heard.count[1] >= total, _COLLECT):
        raise CalibrationError(f"only {client.heard.count[1]} of {total} readings were received")
    if stages is not None:
        stages.last(progress)


def _identify(client: Client, listeners: _Listeners, total: int, progress: Counting) -> dict[str, Any]:
    progress("identifying", total, total)

    def collected() -> bool:  # the description may come later than the readings
        status = client.heard.said("estimator")
        return status.number("readings") >= total and status.entries.get("session") == "described"

    while True:
        if not client.wait(collected, _COLLECT):
            has, resets = (client.heard.said("estimator").number(name) for name in ("readings", "resets"))
            why = "; estimator/reset was called during the measurement" if resets else ""
            raise CalibrationError(f"the estimator has {has} of {total} readings{why}")
        said = [*listeners.remarks]  # nothing comes of it where the estimator is started again meanwhile
        if client.outcome("estimator/identify", _IDENTIFY, partial(operator.ne, said, listeners.remarks)):
            break
    if not client.wait(lambda: bool(client.heard.published.document), _COLLECT):
        raise CalibrationError("the estimator's result did not arrive")
    document: dict[str, Any] = json.loads(client.heard.published.document)
    return document


def _save(client: Client, output: Path) -> Session | None:
    """Write the readings received so far as a session folder; None if there are none."""
    description, readings = client.heard.session()
    if not readings or not description:
        return None
    session = live_session(description, readings, check=False)
    write_session(session, output / "session")
    return session

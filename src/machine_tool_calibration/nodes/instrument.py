# SPDX-License-Identifier: Apache-2.0
"""The displacement instrument: a laser interferometer, simulated or real.

Publishes the stream of displacements in batches, takes readings on request (`instrument/capture` waits until the path
is stable and averages), makes the present path zero (`instrument/datum`), and publishes the environment. A broken beam
loses the count: readings are refused until the datum is set again. In simulated time there is no stream between the
readings; each reading publishes the samples that it averaged.
"""

import time
import uuid
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.instruments.drivers import load_driver
from machine_tool_calibration.instruments.samples import Batch, DriverSource, NotYet, Recent, Window
from machine_tool_calibration.nodes.commanded import INPUT, Pairs, PointerCommand, hear_targets, setup_named
from machine_tool_calibration.nodes.descriptions import description_of
from machine_tool_calibration.nodes.environment import EnvironmentTopics
from machine_tool_calibration.nodes.ros.messages import LATCHED, STATE, Level, StatusTopic, from_message, now, seconds
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.poses import place_of, rotation_of
from machine_tool_calibration.nodes.ros.services import Outcomes, Reply, offer_later
from machine_tool_calibration.simulation.interferometer import SimulatedSource
from machine_tool_calibration.simulation.optics import make_optics
from machine_tool_calibration.simulation.site import Beam, Site, read_site

_GRACE = 0.5  # s of the wall clock: messages about the axes and the beam may arrive in either order


@dataclass
class _Request:
    answer: Reply
    is_datum: bool
    since: float


class Instrument(ManagedNode):
    """See the module; parameters are described where they are declared."""

    _simulated: SimulatedSource | None = None

    def _configure(self) -> None:
        self._site = Site(read_site(self._file))
        self._is_simulated = self._driver == "simulated"
        if not self._is_simulated:
            if self._simulated_time:
                raise CalibrationError("a real driver needs real time: use_sim_time must be false")
            load_driver(Path(self._driver))  # refused here, and not when it is wanted

    def _activate(self) -> None:
        self._epoch = uuid.uuid4().hex[:12]
        self._datums = 0
        self._datum: str = ""
        self._zero = 0.0
        self._reason = "no datum has been set since the start"
        self._requests: list[_Request] = []
        self._recent = Recent(2.0 * self._averaging)
        self._setups: list[str] = []
        self._waiting: PointerCommand | None = None
        self._pairs = Pairs()

        self._stream = self.create_publisher(Float64MultiArray, "~/displacement", STATE)
        self._environment = EnvironmentTopics(self, self._sensed)
        self.source: DriverSource | SimulatedSource
        if self._is_simulated:
            self._simulated = self.source = SimulatedSource(
                self._site, self._origin, self._rate, self._sample_noise, keep=2 if self._simulated_time else 4000
            )
            self._simulated.blocked = self._blocked
            for body in ("functional_point", "table"):
                self.create_subscription(PoseStamped, f"truth/{body}", partial(self._body, body=body), STATE)
            hear_targets(self, self._commanded)
            self.create_subscription(PoseStamped, "truth/beam", partial(self._pointed, 0), STATE)
            self.create_subscription(JointState, "pointer/state", partial(self._pointed, 1), STATE)
            self.create_subscription(String, "session", self._described, LATCHED)
        else:
            self.source = DriverSource(load_driver(Path(self._driver)), now(self) - time.monotonic_ns())
        hardware_id = self.source.hardware_id or Path(self._driver).stem
        self._status = StatusTopic(self, "instrument", hardware_id=hardware_id)
        self._outcomes = Outcomes(self)
        offer_later(self, "~/datum", lambda answer: self._requested(answer, is_datum=True))
        offer_later(self, "~/capture", lambda answer: self._requested(answer, is_datum=False))
        self.every(0.1, self._check)
        if not self._simulated_time:
            self.every(1.0 / self._batch_rate, self._flow)
        self._show()

    def _settings(self) -> None:
        self._simulated_time = self.lives_in_simulated_time
        self._file, self._origin = self.site_and_origin()
        self._driver, self._rate, self._batch_rate = self.values("driver", "rate", "batch_rate")
        self._averaging, self._tolerance = self.values("averaging", "stable_tolerance")
        self._timeout, self._sample_noise = self.values("capture_timeout", "sample_noise")
        (self._blocked,) = self.values("beam_blocked")

    def check_parameters(self, wanted: Mapping[str, Any]) -> None:
        """See `GuardedNode`; the simulated beam is blocked at once."""
        if "beam_blocked" in wanted and self._simulated is not None:
            self._simulated.blocked = bool(wanted["beam_blocked"])
            if self._simulated.blocked:
                self._simulated.lose("the beam is blocked")
            self._note_loss()

    # --- what the simulated axes and pointer say

    @property
    def _world(self) -> SimulatedSource:
        assert self._simulated is not None, "heard by a simulated instrument only"
        return self._simulated

    def _described(self, message: String) -> None:
        session = description_of(message.data)
        self._setups = [setup.id for setup in session.setups]
        try:
            self._world.look_at(make_optics(self._site, session))
        except CalibrationError as error:
            self.get_logger().error(str(error))
        if self._waiting is not None:
            self._commanded(self._waiting)

    def _body(self, message: PoseStamped, body: str) -> None:
        if self._world.optics.body != body:
            return
        stamp = from_message(message.header.stamp)
        self._world.add_pose(stamp, place_of(message.pose.position), rotation_of(message.pose.orientation))
        if self._simulated_time:
            self._environment.tell(stamp)
            self._answer_requests()

    def _pointed(self, side: int, message: PoseStamped | JointState) -> None:
        """The true beam, and what the pointer says of itself: the setup that the beam belongs to."""
        if not self._world.optics.aims:
            return
        stamp = from_message(message.header.stamp)
        if (pair := self._pairs.put(side, stamp, message)) is None:
            return
        truth, state = pair
        setup = setup_named(state, self._setups)
        if self._world.setup and not setup:
            return  # a pointer that has just started again: the instrument stands where it stood
        beam = Beam(place_of(truth.pose.position), rotation_of(truth.pose.orientation)[:, 0])
        self._stand(stamp, setup, beam)

    def _commanded(self, target: PointerCommand) -> None:
        """Axes and pointer move; an instrument whose beam is fixed learns from it at which setup it stands."""
        self._world.expect(target.stamp)
        setup = target.setup(self._setups)
        self._waiting = None if setup else target  # the session that describes it may be under way
        if self._world.optics.aims or not setup:
            return
        self._stand(target.stamp, setup)

    def _stand(self, stamp: int, setup: str, beam: Beam | None = None) -> None:
        """The instrument stands at a setup from a time on; that it was moved is no fault, but its count is void."""
        index = self._setups.index(setup) if setup in self._setups else 0
        if moved := self._world.set_setup(stamp, setup, index, beam):
            self._lose_datum(moved, is_fault=False)
        self._note_loss()
        if self._simulated_time:
            self._answer_requests()

    # --- requests

    def _requested(self, answer: Reply, *, is_datum: bool) -> None:
        self._note_loss()
        if not is_datum and not self._datum:
            self._refuse_without_datum(answer)
            return
        self._requests.append(_Request(answer, is_datum, time.monotonic()))
        if self._simulated_time:
            self._answer_requests()

    def _answer_requests(self) -> None:
        """Answer what can be answered now; the rest waits for samples or its deadline."""
        waiting, self._requests = self._requests, []
        for request in waiting:
            try:
                window = self._window()
            except NotYet as reason:
                self._refuse_or_wait(request, reason)
                continue
            if request.is_datum:
                self._set_datum(request.answer, window)
            else:
                self._reading(request.answer, window)

    def _window(self) -> Window:
        if self._simulated_time and self._simulated is not None:
            return self._simulated.window(self._averaging)
        if problem := self.source.problem():
            raise NotYet("other", problem)
        if self._simulated is not None:
            self._simulated.need_answers()
        return self._recent.window(self._averaging, self._tolerance)

    def _refuse_or_wait(self, request: _Request, reason: NotYet) -> None:
        patience = _GRACE if self._simulated_time else self._timeout  # simulated time does not go on by itself
        is_blocked = reason.kind == "beam" and self._simulated is not None and self._simulated.blocked
        if time.monotonic() - request.since < patience and not is_blocked:
            self._requests.append(request)
            return
        if reason.kind == "beam":
            self._lose_datum(str(reason))
        verb = "datum" if request.is_datum else "capture"
        self._outcomes.answer([request.answer], verb, now(self), str(reason), {}, reason.kind)

    def _refuse_without_datum(self, answer: Reply) -> None:
        text = f"no datum: {self._reason}; call instrument/datum"
        self._outcomes.answer([answer], "capture", now(self), text, {}, "datum")

    def _set_datum(self, answer: Reply, window: Window) -> None:
        self._datums += 1
        self._datum, self._zero, self._reason = f"{self._epoch}-{self._datums}", window.path, ""
        self._show()
        text = f"the path is zero from here: datum {self._datum}"
        self._outcomes.answer([answer], "datum", window.stamp, text, self._taken(window))

    def _reading(self, answer: Reply, window: Window) -> None:
        if not self._datum:
            self._refuse_without_datum(answer)
            return
        displacement = window.path - self._zero
        found = {
            **self._taken(window),
            "displacement": displacement,
            "standard_deviation": window.spread,
            "samples": window.samples,
            **self._sensed(window.stamp),
        }
        text = f"{1e3 * displacement:.6f} mm from the datum"
        self._outcomes.answer([answer], "capture", window.stamp, text, found)
        if self._simulated_time and self._simulated is not None:
            self._publish_stream(self._simulated.averaged)

    def _taken(self, window: Window) -> dict[str, object]:
        inputs = {f"{INPUT}{name}": stamp for name, stamp in window.inputs.items()}
        return {"datum": self._datum, "start": window.start, "end": window.end, **inputs}

    # --- the stream, the state, the environment

    def _flow(self) -> None:
        batch = self.source.take(now(self))
        self._note_loss()
        if len(batch):
            self._recent.add(batch)
            self._publish_stream(batch)
        self._answer_requests()

    def _publish_stream(self, batch: Batch) -> None:
        rows = np.column_stack([batch.time * 1e-9, batch.path - self._zero])
        message = Float64MultiArray(data=array("d", np.ascontiguousarray(rows).tobytes()))
        message.layout.dim = [
            MultiArrayDimension(label="sample", size=len(rows), stride=rows.size),
            MultiArrayDimension(label="time,displacement", size=2, stride=2),
        ]
        self._stream.publish(message)

    def _note_loss(self) -> None:
        if reason := self.source.lost():
            self._lose_datum(reason)

    def _lose_datum(self, reason: str, *, is_fault: bool = True) -> None:
        if self._datum and is_fault:
            self.get_logger().warning(f"the datum is lost: {reason}")
        self._datum, self._reason = "", reason
        self._recent.clear()
        self._show()

    def _check(self) -> None:
        """A few times a second: deadlines of requests, the link, the environment in real time."""
        self._note_loss()
        self._answer_requests()
        self._show()
        if not self._simulated_time:
            self._environment.tell(now(self))

    def _show(self) -> None:
        problem = self.source.problem()
        state = "no signal" if problem else "measuring" if self._datum else "no datum"
        text = problem or self._reason or "measuring"
        level = Level.OK if state == "measuring" else Level.WARN
        entries = {"state": state, "datum": self._datum, "epoch": self._epoch, "driver": self._driver}
        self._status.show(level, text, entries)

    def _sensed(self, stamp: int) -> dict[str, float]:
        """The environment that this node knows itself; with a real driver the sensors publish it."""
        return self._site.sensed(seconds(stamp - self._origin)) if self._simulated is not None else {}

    def _deactivate(self) -> None:
        """Stop what runs beside the node's own thread."""
        self.source.close()

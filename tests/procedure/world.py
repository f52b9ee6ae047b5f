# SPDX-License-Identifier: Apache-2.0
"""Axes, pointer and instrument for tests of the sequencer: they delay, repeat, lose and exchange what they say.

What each partner has been told and what it knows of the others travels separately, as the topics of the graph do: so
the instrument may be asked for a reading before it knows where the axes are.
"""

import math
import random
from collections.abc import Callable

import numpy as np

from machine_tool_calibration.procedure.events import (
    Aim,
    Aimed,
    Arrived,
    Ask,
    Captured,
    CaptureFailed,
    DatumSet,
    Emit,
    Motion,
    Phase,
    State,
    Stop,
    Timing,
)
from machine_tool_calibration.procedure.sequencer import Sequencer
from machine_tool_calibration.procedure.steps import Plan, pointing

SECOND = 1_000_000_000
TICK = 0.1


class World:
    """Runs a sequencer until it ends.

    Args:
        plan: what it measures.
        seed: of everything that happens by chance.
        loss: probability that a message is lost.
        disorder: messages wait up to this many turns.
    """

    def __init__(self, plan: Plan, seed: int = 0, loss: float = 0.0, disorder: int = 0, timing: Timing | None = None):
        self.random = random.Random(seed)
        self.loss, self.disorder = loss, disorder
        self.plan = plan
        self.sequencer = Sequencer(plan, timing or Timing(paced=False, resend=0.5, answer=0.5, patience=60.0))
        self.clock, self.wall, self.turn = 1000 * SECOND, 0.0, 0
        self.mail: list[tuple[int, int, object]] = []
        self.emitted: list[Emit] = []
        self.epochs = {"axes": "a1", "instrument": "i1"}
        self.dead: set[str] = set()
        # the axes: where they are; the pointer: at what it points; the instrument: what it has heard of both
        self.axes = {"x": 0.0, "y": 0.0}
        self.moves: list[Motion] = []
        self.pointer: tuple[str, tuple[float, float, float]] = ("", (0.0, 0.0, 0.0))
        self.heard: dict[str, object] = {}
        self.datum, self.zero, self.datums = "", 0.0, 0
        self.before: Callable[[], object] = lambda: None
        """What happens before a message is delivered."""
        self.stations = {s.id: np.array(s.position) for s in plan.procedure.session.setups}

    # --- truth

    def path(self, setup: str, place: dict[str, float]) -> float:
        return float(np.linalg.norm(np.array([place["x"], place["y"], 0.0]) - self.stations[setup]))

    # --- mail

    def post(self, to: str, content: object) -> None:
        if self.random.random() < self.loss:
            return
        copies = 2 if self.random.random() < self.loss else 1
        for _ in range(copies):
            self.mail.append(
                (self.turn + self.random.randint(0, self.disorder), self.random.randint(0, 9), (to, content))
            )

    def run(self, turns: int = 200_000) -> None:
        """Deliver messages until the procedure ends or nothing happens any more."""
        if self.sequencer.state is State.IDLE:
            self.do(self.sequencer.start(self.clock, self.wall))
        for _ in range(turns):
            if self.sequencer.state is not State.RUNNING:
                return
            self.turn += 1
            due = sorted((entry for entry in self.mail if entry[0] <= self.turn), key=lambda entry: entry[:2])
            if due:
                self.mail.remove(due[0])
                to, content = due[0][2]
                self.deliver(to, content)
            elif not self.mail:
                self.wall += TICK
                self.heartbeat()
                self.do(self.sequencer.tick(self.clock, self.wall))

    def deliver(self, to: str, content: object) -> None:
        self.before()
        if to in self.dead:
            return
        match to:
            case "axes":
                self.move(content)
            case "pointer":
                self.aim(content)
            case "instrument":
                self.asked(content)
            case "instrument hears":
                name, stamp, value = content
                if name not in self.heard or self.heard[name][0] <= stamp:
                    self.heard[name] = (stamp, value)
            case "procedure":
                self.do(self.sequencer.handle(content, self.clock, self.wall))

    def do(self, actions: list) -> None:
        for action in actions:
            match action:
                case Motion() | Stop():
                    self.post("axes", action)
                case Aim():
                    self.post("pointer", action)
                case Ask():
                    self.post("instrument", action)
                case Emit():
                    self.emitted.append(action)

    # --- partners

    def heartbeat(self) -> None:
        """What the simulated axes and pointer say again and again."""
        if self.moves:
            self.post("instrument hears", ("axes", self.clock, (self.arrived, dict(self.axes))))
        if self.pointer[0]:
            self.post("instrument hears", ("beam", self.aimed, self.pointer))

    def move(self, motion: Motion | Stop) -> None:
        if isinstance(motion, Stop):
            return
        if not self.moves or self.moves[-1].stamp != motion.stamp:
            if self.moves and motion.stamp < self.moves[-1].stamp:
                return  # an old command, overtaken by a newer one
            self.moves.append(motion)
            self.clock = max(self.clock, motion.stamp)
            self.arrived = self.clock + round(motion.points[-2].time * SECOND)
            self.clock += round(motion.points[-1].time * SECOND)
            self.axes = dict(motion.points[-1].position)
            self.post("instrument hears", ("axes", self.clock, (self.arrived, dict(self.axes))))
        self.post("procedure", Arrived(motion.stamp, self.arrived, self.clock, self.epochs["axes"]))

    def aim(self, aim: Aim) -> None:
        self.pointer = (aim.setup, aim.point)
        stamp = self.aimed = aim.stamp
        azimuth, _elevation = pointing(np.array([aim.point]), self.stations[aim.setup])
        self.post("instrument hears", ("beam", stamp, self.pointer))
        self.post("procedure", Aimed(aim.setup, float(azimuth[0]), 0.0, stamp))

    def asked(self, request: Ask) -> None:
        if "axes" not in self.heard or "beam" not in self.heard:
            self.post("procedure", CaptureFailed(request.token, "other", "nothing is known yet"))
            return
        held, (_arrived, place) = self.heard["axes"]
        stamp, (setup, aimed) = self.heard["beam"]
        if math.hypot(aimed[0] - place["x"], aimed[1] - place["y"]) > 1e-3:
            return  # waits; the procedure asks again
        reading = self.path(setup, place)
        window = {"start": held - SECOND // 10, "inputs": {"functional_point": held, "beam": stamp}}
        if request.phase is Phase.DATUM:
            self.datums += 1
            self.datum, self.zero = f"{self.epochs['instrument']}-{self.datums}", reading
            self.post("procedure", DatumSet(request.token, self.datum, **window))
        elif not self.datum:
            self.post("procedure", CaptureFailed(request.token, "datum", "no datum"))
        else:
            self.post(
                "procedure",
                Captured(
                    request.token,
                    stamp=held - SECOND // 20,
                    end=held,
                    displacement=reading - self.zero,
                    datum=self.datum,
                    columns={"temperature_air": 20.0 + held * 1e-12},
                    **window,
                ),
            )

    def lose_datum(self) -> None:
        """A hand in the beam."""
        self.datum = ""

    def restart_instrument(self) -> None:
        self.epochs["instrument"] = f"i{self.random.random()}"
        self.datum, self.datums = "", 0

    def restart_axes(self) -> None:
        self.epochs["axes"] = f"a{self.random.random()}"
        self.axes, self.moves = {"x": 0.0, "y": 0.0}, []

    # --- verdict

    def check(self) -> None:
        """Every reading is the one of its own step: displacement from the setup's first target, direction, order."""
        steps = self.plan.steps
        assert len(self.emitted) == len(steps)
        first = {}
        for step, emit in zip(steps, self.emitted, strict=True):
            first.setdefault(step.setup, step)
            expected = self.path(step.setup, step.position) - self.path(step.setup, first[step.setup].position)
            assert list(self.stations)[int(emit.columns["setup_index"])] == step.setup
            assert emit.columns["repeat"] == step.repeat
            assert (emit.columns["x"], emit.columns["y"]) == (step.position["x"], step.position["y"])
            assert emit.columns["dir_x"] == step.direction["x"]
            assert emit.columns["displacement"] == _near(expected)
            assert emit.columns["temperature_air"] == _near(20.0 + (emit.stamp + SECOND // 20) * 1e-12)
        times = [emit.columns["time"] for emit in self.emitted]
        assert times == sorted(times)
        assert len(set(times)) == len(times)


def _near(value: float):
    import pytest

    return pytest.approx(value, abs=1e-12)

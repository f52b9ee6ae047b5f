# SPDX-License-Identifier: Apache-2.0
"""A measurement that ends when it tells enough: after every stage what is known is held against what is wanted.

A stage is a repeat of a setup, or a part of one that is long.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from machine_tool_calibration.budget.enough import Reached, Until, determined, reached
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes.ros.messages import LATCHED, Level, StatusTopic
from machine_tool_calibration.planning.forecast import planned_session
from machine_tool_calibration.procedure import plan
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.collect import live_session

if TYPE_CHECKING:
    from machine_tool_calibration.nodes.client import Client
    from machine_tool_calibration.procedure import Procedure

_ANSWER = 60.0  # s
# Readings of a stage at most: a minute or two.
_LONGEST = 40


def stage_of(procedure: Procedure) -> int:
    """How many readings a stage has."""
    session = procedure.session
    repeat = len(plan(procedure).steps) / (len(session.setups) * session.repeats)
    return ceil(repeat / ceil(repeat / _LONGEST))


class Stages:
    """Decides between stages whether the measurement goes on, and says so on `until/status`.

    The client is beside the graph, which runs the procedure and pauses before every stage; `until` is what is to be
    reached by a variant of the model (its default if None) with effects. `by_hand`: a person takes the instrument to
    its setups, if it has to be taken there.
    """

    def __init__(
        self,
        client: Client,
        procedure: Procedure,
        until: Until,
        *,
        model: str | None,
        effects: tuple[str, ...],
        by_hand: bool,
    ) -> None:
        self._client, self._until = client, until
        self._model, self._effects = model, effects
        self._by_hand = by_hand and bool(method_spec(procedure.session.method).mounted(procedure.session))
        self._own = tuple(own_effects(()))
        self._wanted = 1
        if self._until.u is not None:  # all that the whole procedure determines
            self._wanted = determined(FitRequest((planned_session(procedure).session,), None, self._model))
        self.reached: list[Reached] = []  # after each stage so far
        publisher = client.node.create_publisher(DiagnosticArray, "until/status", LATCHED)
        self._status = StatusTopic(client.node, "until", publisher=publisher)

    def next(self, progress: Callable[[str, int, int], None]) -> None:
        """Ask for the next stage, or for the end, of a procedure that waits for it.

        Where a person has to bring the instrument to another setup, it is the person who resumes.
        """
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

    def last(self, progress: Callable[[str, int, int], None]) -> Reached:
        """What is known after the readings so far."""
        captured, total = (self._client.procedure.number(name) for name in ("captured", "total"))
        if not self._client.wait(lambda: self._client.heard.count[1] >= captured, _ANSWER):
            raise CalibrationError(f"only {self._client.heard.count[1]} of {captured} readings were received")
        if self.reached and self.reached[-1].readings == captured:
            return self.reached[-1]
        progress("is it enough?", captured, total)
        text, readings = self._client.heard.session()
        chosen = FitRequest((live_session(text, readings, check=False),), None, self._model, self._effects, self._own)
        found = reached(chosen, self._until, self._wanted)
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

# SPDX-License-Identifier: Apache-2.0
"""A procedure while it runs: what to ask next, and which answer belongs to which step.

Nothing here depends on the order in which messages arrive: a motion is known by the stamp of its command, a service
call by its token, a beam by its setup and angles, and a reading counts only if its averaging window began after the
axes and the beam had come to rest where the step wants them.
"""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.procedure import events
from machine_tool_calibration.procedure.events import COUNTERS, DatumGroup, Pending, Phase, State, Timing, Visit
from machine_tool_calibration.procedure.motion import move
from machine_tool_calibration.procedure.steps import Plan, Step, pointing
from machine_tool_calibration.session.collect import READING_INDEX
from machine_tool_calibration.session.description import Direct, Probing, StationSetup, TrackingInterferometer

_NANO = 1_000_000_000
_STALE_BEFORE_HOLD = 20
_UNSTABLE_BEFORE_ERROR = 3
_RECOVERIES_BEFORE_ERROR = 3


class Sequencer:
    """Runs a plan by events, with deadlines; every method returns what is to be done now."""

    def __init__(self, plan: Plan, timing: Timing) -> None:
        self.plan = plan
        self.timing = timing
        self.state = State.IDLE
        self.message = "ready to start"
        self.waiting_for = ""
        self.counters = dict.fromkeys(COUNTERS, 0)
        self.done = 0
        self._first = 0  # of the present setup's steps
        self.origin = 0
        self._visits: deque[Visit] = deque()
        self.pending = Pending()  # what the current step waits for
        self._group = DatumGroup()
        self._datums = 0
        self._recoveries = 0
        self._unstable = 0
        self._floor = 0
        self._token = 0
        self._epoch = ""
        self._here: Mapping[str, float] | None = None
        stations = (setup for setup in plan.procedure.session.setups if isinstance(setup, StationSetup))
        self._stations = {station.id: np.array(station.position) for station in stations}

    @property
    def step(self) -> Step | None:
        """The step that is measured now, or None after the last."""
        return self.plan.steps[self.done] if self.done < len(self.plan.steps) else None

    # --- what a person asks

    def start(self, now: int, wall: float, here: Mapping[str, float] | None = None) -> list[events.Action]:
        """Begin with the first step; `here` is where the axes stand, if that is known."""
        # the clock may not show yet when the axes were stopped, and a command is known by its stamp
        self.done, self._floor = 0, max(now, self._floor)
        self._recoveries = self._unstable = 0
        self._group, self._datums, self._here = DatumGroup(), 0, here
        self.counters, self.origin = dict.fromkeys(COUNTERS, 0), self._floor
        self.state, self.message = State.RUNNING, "measuring"
        return self._next(now, wall)

    def pause(self) -> None:
        """Ask for nothing more; the step under way is measured again later."""
        self.state, self.message = State.PAUSED, "paused"
        self._forget()

    def resume(self, now: int, wall: float) -> list[events.Action]:
        """Go on at the step that was interrupted, approached as planned."""
        self.state, self.message = State.RUNNING, "measuring"
        self._recoveries = self._unstable = 0
        return self._begin(now, wall, again=True) if self._visits else self._next(now, wall, resumed=True)

    def finish(self) -> None:
        """End with the readings so far, which are the whole measurement; only while paused."""
        self.state = State.FINISHED
        self.message = f"finished after {self.done} of {len(self.plan.steps)} readings"
        self._forget()
        self._visits.clear()

    def abort(self, now: int) -> list[events.Action]:
        """Stop the axes and end."""
        self.state, self.message = State.ABORTED, f"aborted after {self.done} of {len(self.plan.steps)} readings"
        self._forget()
        self._visits.clear()
        return [events.Stop(self._stamp(now))]

    # --- what the others answer

    def handle(self, event: events.Event, now: int, wall: float) -> list[events.Action]:
        """Take an answer; answers that belong to nothing are ignored."""
        if self.state is not State.RUNNING:
            return []
        match event:
            case events.Arrived():
                return self._arrived(event, now, wall)
            case events.MovedAway():
                return self._moved_away(event, now, wall)
            case events.Refused():
                if self.pending.motion is not None and event.command == self.pending.motion.stamp:
                    return self._fail(f"axes: {event.reason}")
                return []
            case events.Aimed():
                return self._aimed(event, now, wall)
            case events.DatumSet():
                return self._datum_set(event, now, wall)
            case events.Captured():
                return self._captured(event, now, wall)
            case events.CaptureFailed():
                return self._capture_failed(event, now, wall)

    def tick(self, now: int, wall: float) -> list[events.Action]:
        """Look at the deadlines; to be called a few times a second."""
        pending = self.pending
        if self.state is not State.RUNNING or pending.phase is Phase.NONE:
            return []
        is_asked = pending.phase is not Phase.MOVE and pending.token >= 0
        if wall - pending.sent < (self.timing.answer if is_asked else self.timing.resend) + pending.expected:
            return []
        if pending.phase is Phase.MOVE:
            missing = {
                "axes": pending.motion is not None and pending.arrived is None,
                "rotary pointer": pending.aim is not None and pending.aimed is None,
            }
            self.waiting_for = " and ".join(name for name, is_missing in missing.items() if is_missing)
        else:
            self.waiting_for = "instrument"
        if wall - pending.since > self.timing.patience + pending.expected:
            return self._fail(pending.reason or f"no answer from {self.waiting_for} for {wall - pending.since:.0f} s")
        self.counters["resent"] += 1
        pending.sent = wall
        if pending.phase is not Phase.MOVE:
            return self._ask(pending.phase, wall, repeated=True)
        actions: list[events.Action] = []
        if pending.arrived is None and pending.motion is not None:
            actions.append(pending.motion)
        if pending.aimed is None and pending.aim is not None:
            actions.append(pending.aim)
        return actions

    # --- one step

    def _next(self, now: int, wall: float, *, resumed: bool = False) -> list[events.Action]:
        if (step := self.step) is None:
            self.state, self.message = State.FINISHED, f"{self.done} readings"
            return self._forget()
        if step.datum:
            self._group = DatumGroup()
        message = self._waits(step)
        if message and not resumed:
            self.state, self.message = State.PAUSED, message
            return self._forget()
        self._visits = deque([Visit(step, step.datum)])
        return self._begin(now, wall, again=resumed)

    def _waits(self, step: Step) -> str:
        """What a person is told who is waited for before a step; nothing where nobody is."""
        is_new = self.done == 0 or self.plan.steps[self.done - 1].setup != step.setup
        if is_new:
            self._first = self.done
            waits = self.done > 0 and self.timing.wait_between_setups
            return f"bring the instrument to setup {step.setup}, then resume" if waits else ""
        readings, every = self.done - self._first, self.timing.wait_every
        return f"{readings} readings of setup {step.setup}: resume or finish" if every and not readings % every else ""

    def _begin(self, now: int, wall: float, *, again: bool) -> list[events.Action]:
        """Command the axes and the pointer to the first visit's target."""
        step = self._visits[0].step
        via = step.via
        if again and not via and step.number > 0:
            via = (self.plan.steps[step.number - 1].position,)  # the same direction of approach
        return self._command((*via, step.position), step, now, wall)

    def _command(
        self, places: tuple[Mapping[str, float], ...], step: Step, now: int, wall: float
    ) -> list[events.Action]:
        points, clock = [], 0.0
        for place in places:
            here = self._here if self._here is not None and self._here.keys() >= place.keys() else place
            part = move({name: here[name] for name in place}, place, self.plan.limits)
            clock += max(part.duration, 1e-3)  # a controller wants times that increase
            points.append(events.Waypoint(place, clock))
            self._here = place
        dwell = self.plan.procedure.motion.dwell
        points.append(events.Waypoint(step.position, clock + dwell))
        stamp = self._stamp(now)
        motion = events.Motion(stamp, tuple(points))
        pending = Pending(Phase.MOVE, motion, since=wall, sent=wall)
        pending.expected = clock + dwell if self.timing.paced else 0.0
        actions: list[events.Action] = [motion]
        if step.aim is not None:
            aim = events.Aim(stamp, step.setup, step.aim)
            actions.append(aim)  # a fixed instrument learns from it at which setup it stands
            if step.points:
                pending.aim, pending.angles = aim, self._angles(step)
        self.pending = pending
        self.waiting_for = ""
        return actions

    def _stamp(self, now: int) -> int:
        """Identity of a command: even, as a probe's own are odd, so that two who command at the same time differ."""
        earliest = max(now, self._floor + 1)
        self._floor = earliest + earliest % 2
        return self._floor

    def _hold(self, now: int, wall: float) -> list[events.Action]:
        """Stay where it is for another dwell: advances simulated time, gives a real axis time to settle."""
        step = self._visits[0].step
        return self._command((step.position,), step, now, wall)

    def _arrived(self, event: events.Arrived, now: int, wall: float) -> list[events.Action]:
        pending = self.pending
        if pending.phase is not Phase.MOVE or pending.motion is None or event.command != pending.motion.stamp:
            return []
        restarted = bool(self._epoch) and event.epoch != self._epoch
        self._epoch = event.epoch
        if restarted:  # it did not come from where the plan says: the direction of approach is not certain
            self.counters["restarts"] += 1
            return self._begin(max(now, event.held), wall, again=True)
        pending.arrived = event
        self._floor = max(self._floor, event.held)
        return self._at_rest(now, wall)

    def _moved_away(self, event: events.MovedAway, now: int, wall: float) -> list[events.Action]:
        """A reading would be that of another place: go back and measure again."""
        there = self.pending.arrived
        # a probe moves the axes itself, and says where it has touched
        if there is None or isinstance(self.plan.procedure.session, Probing):
            return []
        if event.epoch == there.epoch and event.stamp <= there.held:
            return []  # said before, and late
        if self._unstable_too_often():
            return self._fail("axes: another command moves them while a reading is taken")
        return self._begin(max(now, event.stamp), wall, again=True)

    def _aimed(self, event: events.Aimed, now: int, wall: float) -> list[events.Action]:
        pending = self.pending
        if pending.phase is not Phase.MOVE or pending.aim is None or pending.aimed is not None:
            return []
        azimuth, elevation = pending.angles
        off = max(abs(math.remainder(event.azimuth - azimuth, math.tau)), abs(event.elevation - elevation))
        is_of_this_aim = event.setup == pending.aim.setup and event.stamp >= pending.aim.stamp
        if not (is_of_this_aim and off <= self.timing.pointing_tolerance):
            return []
        pending.aimed = event.stamp
        return self._at_rest(now, wall)

    def _at_rest(self, now: int, wall: float) -> list[events.Action]:
        """Both axes and beam have come to rest: zero or capture."""
        pending = self.pending
        if pending.arrived is None or (pending.aim is not None and pending.aimed is None):
            return []
        is_jumped = pending.arrived.held > pending.arrived.arrived
        if is_jumped and pending.aimed is not None:
            dwell = self.plan.procedure.motion.dwell * _NANO
            if pending.arrived.held - pending.aimed < 0.5 * dwell:  # the pointer took longer than the axes
                self._floor = max(self._floor, pending.aimed)
                return self._hold(max(now, pending.aimed), wall)
        self.waiting_for = ""
        return self._ask(Phase.DATUM if self._visits[0].datum else Phase.CAPTURE, wall)

    def _ask(self, phase: Phase, wall: float, *, repeated: bool = False) -> list[events.Action]:
        """Ask the instrument; a repeated request is the same one, whose answer may only be late."""
        self._token += 1
        pending = self.pending
        pending.token = self._token
        if not repeated:
            pending.first = self._token
        if pending.phase is not phase:
            pending.since, pending.expected = wall, 0.0
            if phase is Phase.DATUM:
                pending.zeroing = self._token
        pending.phase, pending.sent = phase, wall
        return [events.Ask(self._token, phase)]

    def _datum_set(self, event: events.DatumSet, now: int, wall: float) -> list[events.Action]:
        pending = self.pending
        if pending.phase is Phase.CAPTURE and 0 <= pending.zeroing <= event.token < pending.first:
            # the request was repeated and is carried out twice: readings count from the later datum
            self._group.datum = event.datum
            return []
        if pending.phase is not Phase.DATUM or not self.pending.is_asked(event.token):
            return []
        if self.pending.is_stale(event):
            return self._ask_again(now, wall)
        self._group.datum = event.datum
        self._datums += 1
        return self._ask(Phase.CAPTURE, wall)

    def _captured(self, event: events.Captured, now: int, wall: float) -> list[events.Action]:
        if self.pending.phase is not Phase.CAPTURE or not self.pending.is_asked(event.token):
            return []
        if event.datum != self._group.datum:
            return self._recover("the instrument has lost its datum", now, wall)
        if self.pending.is_stale(event):
            return self._ask_again(now, wall)
        self._floor = max(self._floor, event.end)
        if _is_elsewhere(self._visits[0].step, event):
            self.counters["stale"] += 1
            return self._begin(max(now, event.end), wall, again=True)
        visit = self._visits.popleft()
        if math.isnan(visit.revisit):
            return self._measured(visit.step, event, now, wall)
        return self._revisited(visit, event.displacement, now, wall)

    def _ask_again(self, now: int, wall: float) -> list[events.Action]:
        """The same request, as its answer came from before; now and then with a further dwell."""
        pending = self.pending
        self.counters["stale"] += 1
        pending.stale += 1
        if pending.stale % _STALE_BEFORE_HOLD == 0:
            return self._hold(now, wall)
        return self._ask(pending.phase, wall)

    def _measured(self, step: Step, event: events.Captured, now: int, wall: float) -> list[events.Action]:
        value = event.displacement + self._group.offset
        self._group.taken.append((step, value))
        emit = events.Emit(event.stamp, self._columns(step, event, value))
        self.done += 1
        self._recoveries = self._unstable = 0
        self.message = "measuring"
        return [*self._next(now, wall), emit]  # the axes set off first

    def _revisited(self, visit: Visit, reading: float, now: int, wall: float) -> list[events.Action]:
        self._group.differences.append(visit.revisit - reading)
        if math.isnan(self._visits[0].revisit):
            differences = np.array(self._group.differences)
            self._group.offset = float(differences.mean())
            sigma = self.plan.procedure.session.standard_uncertainty.displacement
            if float(np.ptp(differences)) > 10.0 * sigma:
                return self._fail(
                    "the datum could not be found again: targets measured before and after differ by "
                    f"{np.ptp(differences) * 1e6:.2f} um among themselves"
                )
        return self._begin(now, wall, again=False)

    # --- what goes wrong

    def _capture_failed(self, event: events.CaptureFailed, now: int, wall: float) -> list[events.Action]:
        pending = self.pending
        if pending.phase not in (Phase.DATUM, Phase.CAPTURE) or not pending.is_asked(event.token):
            return []
        if event.kind == "unstable":
            if self._unstable_too_often():
                return self._fail(f"instrument: {event.reason}")
            return self._hold(now, wall)
        if event.kind in ("beam", "datum"):
            return self._recover(event.reason, now, wall)
        # asked again by `tick`, until patience ends
        pending.token, pending.reason, pending.sent = -1, f"instrument: {event.reason}", wall
        return []

    def _unstable_too_often(self) -> bool:
        """Count an attempt at the step that was not stable; whether there were too many."""
        self.counters["unstable"] += 1
        self._unstable += 1
        return self._unstable > _UNSTABLE_BEFORE_ERROR

    def _recover(self, reason: str, now: int, wall: float) -> list[events.Action]:
        """Zero the path again at a target measured before, and measure a few of them to tie the datums."""
        self.counters["recoveries"] += 1
        self._recoveries += 1
        if self._recoveries > _RECOVERIES_BEFORE_ERROR:
            return self._fail(f"instrument: {reason}")
        self.message = f"{reason}; measuring again from a known target"
        step = self.step
        assert step is not None
        known = self._group.taken[-self.timing.revisits :]
        visits = [Visit(old, False, reading) for old, reading in known]
        visits.append(Visit(step, False))
        visits[0].datum = True
        self._visits = deque(visits)
        self._group.datum, self._group.differences = "", []
        if not known:
            self._group.offset = 0.0
        return self._begin(now, wall, again=True)

    def _fail(self, reason: str) -> list[events.Action]:
        self.state, self.message = State.ERROR, reason
        return self._forget()

    def _forget(self) -> list[events.Action]:
        """Answers that are still under way no longer belong to anything, and nothing is to be done."""
        self.pending = Pending()
        self.waiting_for = ""
        return []

    # --- the reading

    def _angles(self, step: Step) -> tuple[float, float]:
        """Commanded azimuth and elevation: Ibaraki et al. 2014, Eq. (1)."""
        azimuth, elevation = pointing(np.array([step.aim]), self._stations[step.setup])
        is_flat = self.plan.procedure.session.axes == "xy"
        return float(azimuth[0]), 0.0 if is_flat else float(elevation[0])

    def _columns(self, step: Step, event: events.Captured, value: float) -> dict[str, float]:
        session = self.plan.procedure.session
        columns = {"time": (event.stamp - self.origin) / _NANO, "repeat": float(step.repeat)}
        columns["setup_index"] = float([setup.id for setup in session.setups].index(step.setup))
        columns |= {name: float(place) for name, place in step.position.items()}
        columns |= {f"dir_{name}": float(sign) for name, sign in step.direction.items()}
        if isinstance(session, TrackingInterferometer):
            columns["azimuth"], columns["elevation"] = self.pending.angles
        if isinstance(session, Direct):
            # what the instrument reads is the whole travel: the deviation is what is left without the commanded one
            sense = session.sense
            columns |= dict(zip(("gx", "gy", "gz"), sense, strict=True))
            first = self._group.taken[0][0].position
            value -= sum(s * (step.position.get(a, 0.0) - first.get(a, 0.0)) for a, s in zip("xyz", sense, strict=True))
        columns["displacement"] = float(value)
        columns |= {name: float(number) for name, number in event.columns.items()}
        columns["datum"] = float(self._datums - 1)
        columns[READING_INDEX] = float(self.done)
        if step.target is not None:
            name = "point_index" if isinstance(self.plan.procedure.session, Probing) else "target_index"
            columns[name] = float(step.target)
        return columns


def _is_elsewhere(step: Step, event: events.Captured) -> bool:
    """Whether a probe has touched another point than the step's, or at another angle: it moves the axes itself."""
    if (point := event.columns.get("point_index")) is None:
        return False
    return point != step.target or abs(event.columns.get("c", 0.0) - step.position.get("c", 0.0)) > 1e-6

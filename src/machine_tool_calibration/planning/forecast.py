# SPDX-License-Identifier: Apache-2.0
"""What a procedure will determine, before it is run: uncertainties, gaps, and the smallest effects to be found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_of_group
from machine_tool_calibration.diagnosis.search.candidates import Candidate, effect_candidates
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.instruments.touch import Part
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal.geometry import runs_of
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.planning.design import SharedErrors
from machine_tool_calibration.planning.dominant import ANGULAR, DRIFT, Dominant, dominant
from machine_tool_calibration.procedure.description import Procedure
from machine_tool_calibration.procedure.steps import Step, plan, pointing
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session import description as sessions
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.method import load
from machine_tool_calibration.session.session import Readings, Session

_HELD = 8_000_000  # numbers in the columns of effects that are kept in memory at a time


@dataclass(frozen=True)
class Visible:
    """The smallest size of an effect that a plan finds with a power of 80 %."""

    effect: str  # its id
    coefficient: str  # the one of its coefficients that is seen best, the others being zero
    size: float  # smallest detectable size, in the unit
    unit: str  # SI
    reading: float  # largest change of a reading that this makes, m


@dataclass(frozen=True)
class Detectable:
    """What a measurement shows of effects."""

    visible: tuple[Visible, ...]  # effects that it could show, the catalogue's order
    absorbed: tuple[str, ...]  # effects that the model takes up
    excluded: Mapping[str, str]  # effects that cannot act here, with the reason


def detectable(joint: JointFit, effects: Sequence[Effect], *, progress: Progress = untold) -> Detectable:
    """The smallest sizes of effects to be found if a fit's readings, whose places alone matter, scatter as declared."""
    screened, excluded = _screened(Pool(joint), effects, progress)
    needed = float(np.log(max(len(screened), 1.0 / priors.EFFECT)))
    best = {candidate.effect: candidate.smallest(needed) for candidate in screened}
    absorbed = tuple(name for name, one in best.items() if one is None)
    return Detectable(tuple(one for one in best.values() if one is not None), absorbed, excluded)


@dataclass(frozen=True)
class _Screened:
    """What a model leaves of a candidate's columns."""

    effect: str  # its id
    count: int  # sets of nonlinear coefficients over which its prior is spread
    # for each set of nonlinear coefficients the coefficients, and of each one's column the squared norm outside the
    # model, whether that is seen at all, and the largest change of a reading
    blocks: tuple[tuple[Sequence[Coefficient], Array, BoolArray, Array], ...]

    def smallest(self, needed: float) -> Visible | None:
        """The coefficient that is seen best, and its smallest size; None if none is seen."""
        best: Visible | None = None
        for named, inner, seen, largest in self.blocks:
            strength = inner * np.array([max(abs(c.low), abs(c.high)) / 2.0 for c in named]) ** 2
            for k in np.flatnonzero(seen).tolist():
                signal = smallest_signal(strength[seen], float(strength[k]), needed + np.log(self.count))
                size = float(signal / np.sqrt(inner[k]))
                reading = size * float(largest[k])
                if best is None or reading < best.reading:
                    best = Visible(self.effect, named[k].name, size, named[k].unit, reading)
        return best


def _screened(pool: Pool, effects: Sequence[Effect], progress: Progress) -> tuple[list[_Screened], dict[str, str]]:
    """Every effect that can act, and why the others cannot; as many in one pass as fit into memory."""
    found: list[_Screened] = []
    excluded: dict[str, str] = {}
    waiting: list[Candidate] = []
    for number, effect in enumerate(effects, 1):
        progress("effects that would show", number / len(effects))
        candidates, without = effect_candidates(pool, [effect])
        excluded |= without
        waiting += candidates
        held = sum(block.columns.size for candidate in waiting for block in candidate.shapes)
        if waiting and (held > _HELD or number == len(effects)):
            found += _outside(pool, waiting)
            waiting = []
    return found, excluded


def _outside(pool: Pool, candidates: Sequence[Candidate]) -> list[_Screened]:
    """The columns outside the model, in one pass: the model is the same for all."""
    stacked = [block.columns for candidate in candidates for block in candidate.shapes]
    projected = pool.screen(np.concatenate(stacked), random=True)
    inner = np.diag(projected.gram)[:-1]
    seen = np.asarray(inner > priors.ABSORBED * projected.squares[:-1])
    ends = np.cumsum([len(columns) for columns in stacked])[:-1]
    largest = (np.abs(columns).max(axis=1) for columns in stacked)
    each = zip(np.split(inner, ends), np.split(seen, ends), largest, strict=True)
    return [
        _Screened(found.name, found.count, tuple((block.coefficients, *next(each)) for block in found.shapes))
        for found in candidates
    ]


_SEED = 0
# How fast machine, table and workpiece follow the air.
_FOLLOWS = {"air": 1.0, "x": 0.7, "y": 0.6, "z": 0.5, "table": 0.4, "work": 0.8}
_OFF = 0.5  # K above 20 degrees Celsius at the start
_MOST_READINGS = 100_000  # more than a day of stops of a second each; ten seconds of computing and less than a gigabyte


def planned_session(procedure: Procedure, warming: float = 1.0) -> Session:
    """The session that a procedure will make, while the air warms by so many K per hour and the machine more slowly.

    It is as if it had been read: of a perfect machine, with the declared uncertainty as noise. A SessionError if the
    procedure cannot be run, gives no map, or has more readings than can be forecast.
    """
    if procedure.path.azimuth is not None:
        raise SessionError(
            f"{procedure.source}: path.azimuth is to find a pointer's centre or zero (mtcal align-pointer); no "
            "errors of the machine come out of it that could be forecast"
        )
    made = plan(procedure, _MOST_READINGS)
    steps, description = made.steps, procedure.session
    setups: tuple[Any, ...] = description.setups
    ids = {entry.id: k for k, entry in enumerate(setups)}
    setup = np.array([ids[step.setup] for step in steps])
    repeat = np.array([step.repeat for step in steps])
    time = np.array(made.ends)
    columns: dict[str, Array] = {"time": time}
    for axis in sorted({name for step in steps for name in step.position}):
        columns[axis] = np.array([step.position.get(axis, 0.0) for step in steps])
        columns[f"dir_{axis}"] = np.array([float(step.direction.get(axis, 1)) for step in steps])
    for name, share in _FOLLOWS.items():
        columns[f"temperature_{name}"] = 20.0 + _OFF + share * warming * time / 3600.0
    columns["air_pressure"] = np.full(len(steps), 101_325.0)
    columns["relative_humidity"] = np.full(len(steps), 0.5)
    spec = method_spec(description.method)
    if spec.planned is None:
        raise SessionError(f"{procedure.source}: nothing is foretold of a {description.method} session")
    path, more, labels = load(spec.planned)(procedure, steps, setup)
    columns |= more
    noise = description.standard_uncertainty.displacement * np.random.default_rng(_SEED).normal(size=len(steps))
    reading = path + noise
    if not spec.reads_deviations:
        runs = (repeat,) if spec.counts_from_run else ()
        targets = (labels["target"].astype(str),) if "target" in labels else ()
        reading = reading - reading[first_of_group(setup, *runs, *targets)]
    readings = Readings(setup, repeat, reading, columns, labels, np.arange(len(steps)))
    return Session(description, readings, f"procedure {procedure.name}")


_Nominal = tuple[Array, dict[str, Array], dict[str, np.ndarray]]
"""Path that a perfect machine shows, further columns and labels."""


def directly(procedure: Procedure, steps: tuple[Step, ...], setup: IntArray) -> _Nominal:
    """No deviation, along the direction that is sensed."""
    direction, n = procedure.session.as_a(sessions.Direct).sense, len(steps)
    return np.zeros(n), {f"g{axis}": np.full(n, direction[j]) for j, axis in enumerate("xyz")}, {}


def touching(procedure: Procedure, steps: tuple[Step, ...], setup: IntArray) -> _Nominal:
    """No deviation, where the stylus touches."""
    description = procedure.session.as_a(sessions.Probing)
    part = Part(description)
    points = [step.target or 0 for step in steps]
    angles = [description.setups[s].c for s in setup]
    centres = [part.touch(point, c, procedure.motion.approach).at(0.0) for point, c in zip(points, angles, strict=True)]
    names = np.array([description.workpiece[point].id for point in points], dtype=object)
    return np.zeros(len(steps)), {axis: np.array([c[axis] for c in centres]) for axis in "xy"}, {"point": names}


def along_diagonals(procedure: Procedure, steps: tuple[Step, ...], setup: IntArray) -> _Nominal:
    """Ways along the beams on the flat mirror."""
    description = procedure.session.as_a(sessions.StepDiagonal)
    beam = np.array([run.beam for run in runs_of(description)])
    return np.asarray(np.einsum("nj,nj->n", _aims(steps), beam[setup])), {}, {}


def to_table(procedure: Procedure, steps: tuple[Step, ...], setup: IntArray) -> _Nominal:
    """Distances from the stations to targets on the table."""
    description = procedure.session.as_a(sessions.RotaryAxis)
    stations = np.array([entry.position for entry in description.setups])[setup]
    names = np.array([description.targets[step.target or 0].id for step in steps], dtype=object)
    return np.linalg.norm(_aims(steps) - stations, axis=1), {}, {"target": names}


def from_stations(procedure: Procedure, steps: tuple[Step, ...], setup: IntArray) -> _Nominal:
    """Distances from the stations to the tool, and the beams' angles."""
    description, aim = procedure.session.as_a(sessions.TrackingInterferometer), _aims(steps)
    stations = np.array([entry.position for entry in description.setups])[setup]
    if description.dimension == 2:
        stations[:, 2] = aim[:, 2]
    azimuth, elevation = pointing(aim, stations)
    return np.linalg.norm(aim - stations, axis=1), {"azimuth": azimuth, "elevation": elevation}, {}


def _aims(steps: tuple[Step, ...]) -> Array:
    return np.array([step.aim or (0.0, 0.0, 0.0) for step in steps])


@dataclass(frozen=True, kw_only=True)
class Forecast(Detectable):
    """What a measurement will determine."""

    result: Result  # as it will be for a machine without errors: its uncertainties and gaps are those to come
    seconds: float  # of motion and waiting; putting up instruments comes on top
    warming: float  # K per hour that was assumed
    dominant: Dominant | None = None  # what will dominate the map's uncertainty by the sizes assumed

    def document(self) -> dict[str, Any]:
        """For programs."""
        found = self.result.document()
        return {
            "format": "mtcal-plan/1",
            "method": found["method"],
            "model": found["model"],
            "readings": found["observations"],
            "seconds": self.seconds,
            "degrees_of_freedom": found["degrees_of_freedom"],
            "uncertainties": {name: value for name, value in found["error_map"].items() if name.endswith("_u")},
            "squareness": [
                {"name": one.name, "standard_uncertainty": one.standard_uncertainty, "unit": one.unit}
                for one in self.result.parameters
                if self.result.joint.assembly.unknowns[one.name].kind is Kind.SQUARENESS
            ],
            "points": found["error_map"].get("points"),
            "not_determined": found["not_determined"],
            "datum": found["datum"],
            "detectable": [asdict(one) for one in self.visible],
            "absorbed": list(self.absorbed),
            "excluded": dict(self.excluded),
            "dominant": None if self.dominant is None else self.dominant.document(),
            "power": priors.DETECTED,
            "assumed": {"warming_per_hour": self.warming, "spread_between_setups": 0.0, "machine": "without errors"},
        }


@dataclass(frozen=True)
class Assumed:
    """What is assumed of a measurement that was not made."""

    model: str | None = None  # variant of the method's model; None for its default
    own: Sequence[Effect] = ()  # the user's own effects, beside the catalogue
    warming: float = 1.0  # change of the air's temperature, K per hour
    angular: float = ANGULAR  # root mean square of the machine's angular errors, rad
    # of the readings of a session, what its budget says beside their scatter; for the choice of a plan
    errors: Callable[[Observations], SharedErrors | None] | None = None


def forecast(procedure: Procedure, assumed: Assumed, progress: Progress = untold) -> Forecast:
    """What a procedure will determine, if its readings scatter as declared and mountings add no spread.

    While the air warms by so many K per hour; for what dominates, with angular errors of that root mean square, rad. A
    SessionError if the procedure cannot be run; a ModelError if it does not allow the model.
    """
    progress("planning the steps", 0.0)
    model, warming = assumed.model, assumed.warming
    session = planned_session(procedure, warming)
    progress("uncertainties", 0.2)
    result = identify(session, model=model, keep_all=True)
    found = detectable(
        result.joint,
        [e for e in catalogue(assumed.own).values() if not e.beside],
        progress=lambda what, share: progress(what, 0.3 + 0.55 * share),
    )
    progress("what dominates", 0.85)
    limits = dominant(session, model=model, angular=assumed.angular, drift=DRIFT * abs(warming))
    seconds = float(session.readings.columns["time"][-1])
    return Forecast(**vars(found), result=result, seconds=seconds, warming=warming, dominant=limits)

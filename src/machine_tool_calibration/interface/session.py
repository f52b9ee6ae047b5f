# SPDX-License-Identifier: Apache-2.0
"""Measurements: read from files, or simulated."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from machine_tool_calibration.diagnosis.compare import one_below_the_other
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.interface.show import Shown, listed, require_kind
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.identification import session_headline
from machine_tool_calibration.reports.information import session_parts
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.session.folder import readings_frame, write_session
from machine_tool_calibration.session.session import Session, distinct_labels, measurement_name, refuse_repeated
from machine_tool_calibration.session.summary import summarize


@dataclass(frozen=True, eq=False, repr=False)
class Measurement(Shown):
    """One session, or several of one machine.

    Attributes:
        sessions: the sessions themselves.
        labels: their names, all different.
        truth: of a simulated one, what was put in, as in `truth.json`: for judging a result, never an input to it.
    """

    sessions: tuple[Session, ...]
    labels: tuple[str, ...]
    truth: Mapping[str, Any] | None = None

    @property
    def method(self) -> str:
        """The measuring method; `joint` of several sessions."""
        return self.sessions[0].method if len(self.sessions) == 1 else "joint"

    @cached_property
    def readings(self) -> pd.DataFrame:
        """Every reading in the order of time, one a row; SI units, temperatures in degrees Celsius.

        The columns are those of `observations.csv` (`time` s, `setup`, `repeat`, `x` `y` `z` m, `c` rad,
        `displacement` m, …); of several sessions `session` comes first. A lost reading has the displacement NaN.
        """
        return one_below_the_other(self.labels, [readings_frame(session) for session in self.sessions])

    @property
    def headline(self) -> str:
        """What was measured, in one line."""
        several = len(self.sessions) > 1
        named = zip(self.labels, self.sessions, strict=True)
        return "; ".join(f"{label}: " * several + session_headline(own) for label, own in named)

    def parts(self) -> Iterator[Part]:
        """Setups and columns, as `mtcal info` prints them; of several sessions one after the other."""
        for session in self.sessions:
            yield from session_parts(session, summarize(session))

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write `session.yaml` and `observations.csv`; of several sessions each into a folder of its label in there.

        Args:
            folder: made where it is missing.
            overwrite: replace a session that is already there.

        Raises:
            SessionError: a session is already there, or the folder cannot be written.
        """
        require_kind(folder, str | os.PathLike, "folder must be a path")
        for label, session in zip(self.labels, self.sessions, strict=True):
            own = Path(folder) if len(self.sessions) == 1 else Path(folder) / label
            write_session(session, own, overwrite=overwrite)


Source = str | os.PathLike[str] | Session | Measurement
"""What can be loaded: a path, or a measurement that is in memory already."""


def load(*sources: Source | Sequence[Source]) -> Measurement:
    """Read a measurement: one session, or several sessions of one machine that are to be fitted together.

    Args:
        sources: session folders or recordings (a folder as rosbag2 writes it, or an `.mcap` file), one by one or in
            a list. What `load` or `simulate` gave before may be among them.

    Raises:
        CalibrationError: nothing to load, or something that is none of these.
        SessionError: a file is missing or says what cannot be, or a measurement is given twice; one line that says what
            and where.
    """
    if not (found := [entry for source in sources for entry in _opened(source)]):
        raise CalibrationError("nothing to load: give a session folder, a recording, or several of them")
    names = distinct_labels([name for name, _, _ in found])
    refuse_repeated([session for _, session, _ in found], names)
    truth = found[0][2] if len(found) == 1 else None
    return Measurement(tuple(session for _, session, _ in found), tuple(names), truth)


def _opened(source: Any) -> Iterator[tuple[str, Session, Mapping[str, Any] | None]]:
    """Name, session and truth of each session in a source."""
    if isinstance(source, str | os.PathLike):
        path = Path(os.fspath(source))
        session = open_measurement(path)  # first: of a name that cannot be there is no real path
        yield measurement_name(path), session, None
    elif isinstance(source, Measurement):
        for label, session in zip(source.labels, source.sessions, strict=True):
            yield label, session, source.truth
    elif isinstance(source, Session):
        yield measurement_name(source.source), source, None
    elif isinstance(source, list | tuple):
        for one in source:
            yield from _opened(one)
    else:
        raise CalibrationError(f"a session is a path or what `load` gave, not {type(source).__name__}")


def simulate(
    plan: str,
    *,
    effects: str | Sequence[str] | Mapping[str, float | Mapping[str, Any]] = (),
    seed: int = 0,
    machine: str | os.PathLike[str] | None = None,
    noise: float | None = None,
    noise_factor: float = 1.0,
    repeatability: float = 0.0,
    spread: float = 0.0,
    chips: float = 0.0,
    missing: float = 0.0,
    **settings: Any,
) -> Measurement:
    """Simulate a measurement on a virtual machine, as `mtcal simulate` does; the same arguments give the same numbers.

    Args:
        plan: a preset (`tracking_2d`, `step_diagonal`, `iso230_2`, …: `mtcal simulate --list` shows them), or a method
            with its usual plan.
        effects: physical effects to put in: ids, each of its typical size; or by id the size (the coefficient of its
            formula, SI), or a mapping with `size` or `amplitude` (largest change of a reading, m) and further
            coefficients, as `{"warmup_x": {"size": 4e-6, "tau": 900.0}}`.
        seed: of all that is random.
        machine: YAML file of the machine's true errors; random ones of a good machining centre if absent.
        noise: declared standard uncertainty of a reading, m; the method's usual one if absent.
        noise_factor: actual noise over the declared one; 0: none.
        repeatability: standard deviation of the machine's position at each visit, m.
        spread: slope and bow of each mounting, standard deviation, m.
        chips: fraction of readings with a gross error.
        missing: fraction of readings that are lost.
        settings: other values of the plan, such as `repeats=3` or `pointing="tracking"`.

    Raises:
        CalibrationError: an unknown plan, effect or setting, a value out of range, or a machine that does not fit.
    """
    from machine_tool_calibration.simulation import PRESETS
    from machine_tool_calibration.simulation import simulate as simulated_by
    from machine_tool_calibration.simulation.spec import PLANS, spec_from

    require_kind(plan, str, "plan must be a name")
    if plan not in PRESETS and plan not in PLANS:
        known = ", ".join(dict.fromkeys([*PLANS, *PRESETS]))
        raise CalibrationError(f"no plan {plan!r}; there are {known}")
    fields = {"seed": seed, "noise": noise, "noise_factor": noise_factor, "repeatability": repeatability}
    fields |= {"spread": spread, "chips": chips or None, "missing": missing}
    method, preset = (None, plan) if plan in PRESETS else (plan, None)
    if machine is not None:
        require_kind(machine, str | os.PathLike, "machine must be a file")
    own, path = _flaws(effects), None if machine is None else os.fspath(machine)
    spec = spec_from(None, method=method, preset=preset, plan=settings, machine=path, effects=own, fields=fields)
    simulated = simulated_by(spec)
    return Measurement((simulated.session,), (plan,), simulated.truth.document())


def _flaws(effects: str | Sequence[str] | Mapping[str, float | Mapping[str, Any]]) -> list[dict[str, Any]]:
    if isinstance(effects, str):
        effects = (effects,)
    if not isinstance(effects, Mapping):
        return [{"id": name} for name in listed("effects", effects)]
    out = []
    for name, said in effects.items():
        given = dict(said) if isinstance(said, Mapping) else {"size": said}
        sized = {key: given.pop(key) for key in ("size", "amplitude") if key in given}
        out.append({"id": name, **sized, "parameters": given})
    return out

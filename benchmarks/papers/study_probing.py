# SPDX-License-Identifier: Apache-2.0
"""Self-calibration of a free-form part by probing on a rotary table: Figs. 18 to 20, Table 2, the pins of Fig. 17."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.probing.features import Features, features
from machine_tool_calibration.methods.probing.model import ProbingModel, common_motions, responses
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.model.rigid_body import map_field
from machine_tool_calibration.session.checks.nominal_geometry import turned
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.simulation import PartPoint, ProbingPlan, SimulationSpec, simulate
from machine_tool_calibration.simulation.probing_run import cross, pins
from papers.record import Printed, Study

__all__ = ["ColouredPoints", "PinPositions", "fit_first_case", "forecast", "planned_session", "study"]


def forecast(description: Probing) -> Result:
    """The result that the planned touches will have; its values are zero, its uncertainties and gaps those to come.

    As in Section 6 of the paper. The model is linear, so that no Monte Carlo is needed.

    Args:
        description: workpiece, angles of C, repeats and the uncertainty of one touch.

    Raises:
        ModelError: the touches are fewer than what they would have to determine.
    """
    return identify(planned_session(description), keep_all=True)


def planned_session(description: Probing) -> Session:
    """A session in which every point is touched at every angle as often as planned; all readings are zero."""
    points = np.array([point.position for point in description.workpiece])
    shape = (len(description.setups), description.repeats, len(points))
    setup, repeat, point = (index.ravel() for index in np.indices(shape))
    c = np.array([entry.c for entry in description.setups])[setup]
    sign = description.machine.rotation_sign or -1
    place = turned(points[point], sign * c)
    readings = Readings(
        setup=setup,
        repeat=repeat,
        displacement=np.zeros(len(setup)),
        columns={"x": place[:, 0], "y": place[:, 1], "c": c},
        labels={"point": np.array([entry.id for entry in description.workpiece], dtype=object)[point]},
        row=np.arange(len(setup)),
    )
    return Session(description, readings, "plan")


_PAPER = (
    "A self-calibration scheme for two-dimensional free-form probing measurement under the assumption of rigid-body "
    "machine kinematic model"
)
# Case study 1: angles of Eq. (19), standard uncertainty of a touch; the grid of -110, -88, … 110 mm.
_ANGLES = (0, 75, 130, 210)
_TOUCH = 1.38e-6
_NODES = tuple(0.022 * k for k in range(-5, 6))
_ARM, _OTHER_ARM = 0.1, 0.082
# Figs. 18 to 20 and Table 2: expanded uncertainties (k = 2), m and rad.
_FORM = {2: 6.5e-6, 3: 3.0e-6, 4: 2.1e-6}
_WITHOUT_SPHERES, _EDGE = 4e-6, 28e-6
_TABLE_2 = {"EXC": (1.0e-6, 1.2e-6, 1.2e-6), "EYC": (0.9e-6, 1.1e-6, 1.2e-6), "ECC": (8.9e-6, 9.3e-6, 8.2e-6)}
# Share of a figure that the paper's rounding, reading a colour, and the largest of many from 1000 draws leave.
_WITHIN = 0.1
_LARGE = 10e-6
# Case study 2: expanded uncertainty 1.8 um of the probe; frame of Section 5.2.
_PIN_TOUCH, _FRAME, _PIN_NODES = 0.9e-6, ("pin1", "pin11"), tuple(0.08 * k for k in range(-5, 6))
_DRAWS = 2000


@dataclass(frozen=True)
class ColouredPoints:
    """Expanded uncertainties (k = 2) shown by colour at the points of a part or the nodes of a grid (Figs. 18 to 20).

    Attributes:
        what: of what they are.
        panels: for each its title, places (n, 2), m, and the uncertainty at each, (n,), m.
    """

    what: str
    panels: tuple[tuple[str, Array, Array], ...]


@dataclass(frozen=True)
class PinPositions:
    """Errors of positions of pins (Fig. 17).

    Attributes:
        found: by self-calibration, less the true ones.
        raw: (q,) the same quantities from the touches at the first angle alone, less the true ones.
    """

    found: Features
    raw: Array


def fit_first_case(angles: int = 4, arm: float = _ARM, spheres: bool = True) -> Fit:
    """Case study 1 before it is measured: 92 points, or 76 without the two spheres.

    Args:
        angles: of C, the first of Eq. (19).
        arm: length of the cross's arms from its middle, m.
        spheres: whether two spheres are probed as well.
    """
    length = {"position": _NODES[-1], "value": 0.0, "standard_uncertainty": 0.0}
    return _planned(cross(half=arm, spheres=spheres), _ANGLES[:angles], _NODES, _TOUCH, {"EXX": length})


def _planned(
    part: Sequence[PartPoint], degrees: Sequence[float], nodes: Sequence[float], touch: float, known: Mapping[str, Any]
) -> Fit:
    description = Probing.model_validate(
        {
            "format": "mtcal-session/1",
            "method": "probing",
            "machine": {"chain": "w-C-b-Y-X-Z-t", "rotation_sign": -1, "table_grid": {"x": nodes, "y": nodes}},
            "workpiece": [{k: v for k, v in p.model_dump().items() if k != "curvature"} for p in part],
            "setups": [{"id": f"C{k + 1}", "c": float(np.radians(angle))} for k, angle in enumerate(degrees)],
            "known": known,
            "standard_uncertainty": {"displacement": touch},
        }
    )
    return forecast(description).fit


@dataclass(frozen=True)
class _Expanded:
    """Expanded uncertainties (k = 2) of a planned measurement, m and rad.

    Attributes:
        place: (N, 2) points of the part.
        datum: (N,) of the part's error where Eqs. (16) and (17) put origin, direction and length.
        form: (N,) without shift, turn and growth of the part as a whole.
        grid: (g, 2) nodes of the linear axes' tables.
        axes: (g,) of the larger component of the position error.
        table: EXC, EYC and ECC at each angle.
        centred: (2, angles) EXC and EYC if the tables were zero in the mean over all touches, not at one node.
    """

    place: Array
    datum: Array
    form: Array
    grid: Array
    axes: Array
    table: dict[str, Array]
    centred: Array

    @classmethod
    def of(cls, fit: Fit) -> _Expanded:
        model = fit.model
        assert isinstance(model, ProbingModel)
        points = model.description.workpiece
        found = responses(fit, model.touches.point, len(points))
        motion = common_motions(model.description, length_known=False)
        still = np.eye(len(points)) - motion @ np.linalg.pinv(motion)
        content = error_map(fit).content
        return cls(
            np.array([point.position for point in points]),
            2.0 * content["workpiece_error_u"],
            2.0 * np.sqrt(np.diag(found.combine(still)[1])),
            content["grid"],
            2.0 * content["position_error_u"].max(axis=1),
            {name: 2.0 * content[f"{name}_u"] for name in _TABLE_2},
            2.0 * _centred(fit, model),
        )


def _centred(fit: Fit, model: ProbingModel) -> Array:
    """(2, angles) standard uncertainty of EXC and EYC with another origin than Eq. (16).

    A shift a of the tables moves the part by as much and EXC, EYC by a - R(C) a.
    """
    names = [parameter.name for parameter in fit.model.parameters]
    mean = map_field(model.tables, model.touches.contact)[:, :, :2].mean(axis=1)
    out = []
    for setup in model.description.setups:
        rows = np.zeros((2, len(names)))
        rows[[0, 1], [names.index(f"{name}({setup.id})") for name in ("EXC", "EYC")]] = 1.0
        rows[:, : len(mean)] -= (mean - turned(mean, np.asarray(model.observations.session.rotation_sign * setup.c))).T
        out.append(np.sqrt(np.maximum(np.diag(rows @ fit.covariance @ rows.T), 0.0)))
    return np.array(out).T


def study(progress: Callable[[str, float], None]) -> Study:
    """The uncertainties of case study 1 from the covariance, and a twin of case study 2."""
    cases = {count: _Expanded.of(fit_first_case(count)) for count in _FORM}
    others = {count: _Expanded.of(fit_first_case(count, _OTHER_ARM)) for count in _FORM}
    bare = _Expanded.of(fit_first_case(spheres=False))
    progress("case study 2", 0.4)
    printed = [*_of_part(cases, others, bare), *_of_axes(cases[4], bare), *_of_table(cases[4])]
    second, positions = _second_case()
    shown = {f"{count} angles, with spheres": case for count, case in cases.items()} | {"4 angles, no sphere": bare}
    return Study(
        id="probing",
        paper=_PAPER,
        assumptions=(
            "The points are not printed: the cross has arms of 100 mm from its middle (82 mm in the remarks), eight "
            "points on each side wall and three on each end wall; spheres at (80, 65) and (-75, -70) mm with eight "
            "points each.",
            "The grid of -110 to 110 mm by 22 mm has 11 nodes; the paper calls its 10 cells the grid.",
            "Ours is the covariance, the paper's 1000 draws, of which it prints the largest by a colour scale: equal "
            "within 10 %.",
            "Pins: 18 of 4 points and 2 spheres of 8 are 88 points; the paper counts 84. The places of the spheres are "
            "not printed, and pin 6 stays on the circle. 1.8 µm (k = 2) is taken for each touch.",
        ),
        printed=(*printed, *second),
        pictures={
            "part": ColouredPoints(
                "U of the part's errors in the datum (Figs. 18 and 19)",
                tuple((title, case.place, case.datum) for title, case in shown.items()),
            ),
            "form": ColouredPoints(
                "U of the part's form, without shift, turn and growth (Figs. 18 and 19)",
                tuple((title, case.place, case.form) for title, case in shown.items()),
            ),
            "axes": ColouredPoints(
                "U of the position errors of X and Y, the larger component (Fig. 20)",
                tuple((title, case.grid, case.axes) for title, case in list(shown.items())[2:]),
            ),
            "pins": positions,
        },
    )


def _of_part(cases: Mapping[int, _Expanded], others: Mapping[int, _Expanded], bare: _Expanded) -> list[Printed]:
    out = []
    for count, paper in _FORM.items():
        where = f"Fig. 18({'abc'[count - 2]})"
        for name, words, why in (
            ("datum", "in the datum", "contains shift, turn and length of the whole, fixed at single nodes; "),
            ("form", "without shift, turn and growth", "as the paper turns the part to fit in Fig. 10; "),
        ):
            ours, other = getattr(cases[count], name), getattr(others[count], name)
            text = f"{why}median {_um(np.median(ours))}; with arms of 82 mm at most {_um(other.max())}"
            what = f"largest U of the part, {words}, {count} angles"
            out.append(Printed(what, where, paper, float(ours.max()), "m", _WITHIN * paper, text))
    n = len(bare.place)
    for words, name in (("in the datum", "datum"), ("without shift, turn and growth", "form")):
        more = float(np.max(getattr(bare, name) - getattr(cases[4], name)[:n]))
        what = f"U of the part without spheres less with them, at most, {words}"
        why = "the paper's is approximate, from two pictures"
        out.append(Printed(what, "Fig. 19", _WITHOUT_SPHERES, more, "m", 0.5e-6, why))
    return out


def _of_axes(case: _Expanded, bare: _Expanded) -> list[Printed]:
    edge = np.abs(case.grid[:, 1]) > 0.109
    zero = float(case.axes[np.all(np.abs(case.grid) < 1e-9, axis=1)][0])
    share = float(np.mean(case.axes < _LARGE))
    elsewhere = f"elsewhere at most {_um(case.axes[~edge].max())}"
    return [
        Printed("U of X and Y at (0, 0)", "Fig. 20(a)", 0.0, zero, "m", 1e-9, "by Eq. (16)"),
        Printed(
            "largest U of X and Y, at Y = ±110 mm", "Fig. 20(a)", _EDGE, float(case.axes[edge].max()), "m",
            _WITHIN * _EDGE, elsewhere,
        ),
        Printed("share of the grid with U below 10 µm", "Fig. 20(a)", None, share, "1", why='"a large portion"'),
        Printed("largest U of X and Y without spheres", "Fig. 20(b)", None, float(bare.axes.max()), "m", why="larger"),
    ]  # fmt: skip


def _of_table(case: _Expanded) -> list[Printed]:
    out = []
    for j, (name, figures) in enumerate(_TABLE_2.items()):
        for k, (angle, paper) in enumerate(zip(_ANGLES[1:], figures, strict=True), 1):
            why = ""
            if name != "ECC":
                zero = "were the tables zero in the mean of all touches, not at X = Y = 0 alone"
                why = f"{_um(case.centred[j, k])} {zero}"
            unit = "rad" if name == "ECC" else "m"
            within = 0.05e-6 + _WITHIN * paper
            ours = float(case.table[name][k])
            out.append(Printed(f"U of {name} at C = {angle}°", "Table 2", paper, ours, unit, within, why))
    return out


def _um(length: float) -> str:
    return f"{1e6 * float(length):.1f} µm"


def _second_case() -> tuple[list[Printed], PinPositions]:
    """A simulated frame with pins: what self-calibration finds, what the first angle alone shows, and U."""
    plan = ProbingPlan(part="pins", noise=_PIN_TOUCH, grid=_PIN_NODES, known_uncertainty=None)
    simulated = simulate(SimulationSpec(plan=plan, seed=1))
    fit = identify(simulated.session).fit
    found = features(fit, frame=_FRAME)
    truth = np.array(simulated.truth.expected["workpiece_error"])
    description, readings = simulated.session.description, fit.model.observations.readings
    assert isinstance(description, Probing)
    first = readings.select(readings.setup == 0)
    place = {point.id: k for k, point in enumerate(description.workpiece)}
    raw = np.zeros(len(place))
    raw[[place[str(name)] for name in first.labels["point"]]] = first.displacement
    errors = replace(found, deviation=found.deviation - found.rows @ truth)
    of_raw = found.rows @ (raw - truth)
    xy = np.array([k for k, q in enumerate(found.quantities) if q.of[0].startswith("pin") and q.what in "xy"])
    covariance = found.uncertainty_matrix[np.ix_(xy, xy)]
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(len(xy)), covariance, _DRAWS, method="eigh")
    most = float(np.quantile([_largest(draw) for draw in drawn], 0.95))
    length = {"position": _PIN_NODES[-1], "value": 0.0, "standard_uncertainty": 0.0}
    angles = tuple(float(np.degrees(setup.c)) for setup in description.setups)
    measured = _planned(pins(), angles, _PIN_NODES, _PIN_TOUCH, {"EXX": length})
    with_length = features(measured, frame=_FRAME).uncertainty[xy].max()
    relative = float(2.0 * found.uncertainty[xy].max())
    rows = (
        ("error of a pin, touches at C = 0° alone", "Fig. 17", _largest(of_raw[xy]), "paper: 8 µm, of its machine"),
        ("error of a pin, self-calibrated", "Fig. 17", _largest(errors.deviation[xy]), "paper: within 2 µm of a CMM"),
        ("error of a pin, in 95 % of measurements", "Fig. 17", most, "from the joint covariance"),
        ("U of a coordinate of a pin", "Section 5", relative, "the part as a whole at its nominal size"),
        ("U of a coordinate of a pin, with a length", "Eq. (17)", float(2.0 * with_length),
         "EXX(400 mm) is known exactly, at a node that few touches reach"),
    )  # fmt: skip
    printed = [Printed(f"largest {what}", where, None, ours, "m", why=why) for what, where, ours, why in rows]
    return printed, PinPositions(errors, of_raw)


def _largest(xy: Array) -> float:
    """Of the lengths of vectors whose components follow one another."""
    return float(np.linalg.norm(xy.reshape(-1, 2), axis=1).max())

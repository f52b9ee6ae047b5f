# SPDX-License-Identifier: Apache-2.0
"""Sessions of every method, damaged in every usual way, are refused in one line that names it; sound ones are not."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.checks.nominal_geometry import turned
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import FLAWS, PRESETS, FlawSpec, SimulationSpec, simulate

from ..plates import with_columns

Damage = Callable[[Session], Session]


@cache
def measured(preset: str) -> Session:
    return simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session


def columns(**change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(session: Session) -> Session:
        old = session.readings.columns
        return session.with_readings(
            replace(session.readings, columns=old | {name: f(old[name]) for name, f in change.items() if name in old})
        )

    return damage


def displacement(factor: float) -> Damage:
    return lambda s: with_columns(s, factor * s.readings.displacement)


def described(session: Session, **change: Any) -> Session:
    return replace(session, description=session.description.model_copy(update=change))


def swapped_rows(one: int, other: int) -> Damage:
    def damage(session: Session) -> Session:
        setup = session.readings.setup
        new = np.where(setup == one, other, np.where(setup == other, one, setup))
        return session.with_readings(replace(session.readings, setup=new))

    return damage


def swapped_entries(one: int, other: int, *keys: str) -> Damage:
    def damage(session: Session) -> Session:
        setups = list(session.description.setups)
        first, second = setups[one], setups[other]
        setups[one] = first.model_copy(update={key: getattr(second, key) for key in keys})
        setups[other] = second.model_copy(update={key: getattr(first, key) for key in keys})
        return described(session, setups=tuple(setups))

    return damage


def swapped_labels(column: str, one: str, other: str) -> Damage:
    def damage(session: Session) -> Session:
        old = session.readings.labels[column].astype(object)
        new = np.where(old == one, other, np.where(old == other, one, old))
        return session.with_readings(replace(session.readings, labels={**session.readings.labels, column: new}))

    return damage


def scaled_entries(name: str, key: str, factor: float) -> Damage:
    def larger(value: Any) -> Any:
        return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value

    def damage(session: Session) -> Session:
        entries = getattr(session.description, name)
        return described(session, **{name: tuple(e.model_copy(update={key: larger(getattr(e, key))}) for e in entries)})

    return damage


def turned_round(session: Session) -> Session:
    machine = session.description.machine.model_copy(update={"rotation_sign": -session.rotation_sign})
    own = {"rotation_sign": -session.rotation_sign} if hasattr(session.description, "rotation_sign") else {}
    return described(session, machine=machine, **own)


def all_of(*damages: Damage) -> Damage:
    def damage(session: Session) -> Session:
        for one in damages:
            session = one(session)
        return session

    return damage


def entry(name: str, index: int, **change: Callable[[Any], Any]) -> Damage:
    """Keys of one entry of the description changed."""

    def damage(session: Session) -> Session:
        entries = list(getattr(session.description, name))
        old = entries[index]
        entries[index] = old.model_copy(update={key: f(getattr(old, key)) for key, f in change.items()})
        return described(session, **{name: tuple(entries)})

    return damage


def moved(axis: int, by: float) -> Callable[[Any], Any]:
    return lambda place: tuple(v + by * (j == axis) for j, v in enumerate(place))


def beam_for_reading(session: Session) -> Session:
    return with_columns(session, session.readings.columns["azimuth"], azimuth=session.readings.displacement)


def fahrenheit(session: Session) -> Session:
    sensed = {n: v for n, v in session.readings.columns.items() if n.startswith("temperature_")}
    return with_columns(session, **{name: 1.8 * values + 32.0 for name, values in sensed.items()})


def recorded_at_declared_angle(session: Session) -> Session:
    declared = np.array([setup.c for setup in session.description.setups])
    return with_columns(session, c=declared[session.readings.setup])


MILLI, DEGREES = (lambda v: 1e3 * v), np.degrees
POSITIONS = columns(x=MILLI, y=MILLI, z=MILLI)
UNITS: dict[str, tuple[Damage, str]] = {
    "readings in millimetres": (displacement(1e3), "millimetres"),
    "readings in micrometres": (displacement(1e6), "micrometres"),
    "positions in millimetres": (POSITIONS, "millimetres"),
}
SIGNS: dict[str, tuple[Damage, str]] = {
    "readings of the other sign": (displacement(-1.0), "opposite sign"),
    "path there and back": (displacement(2.0), "twice the change of path"),
}


def pairs(count: int) -> list[tuple[int, int]]:
    return list(itertools.combinations(range(count), 2))


def swaps(count: int, *keys: str) -> dict[str, tuple[Damage, str]]:
    rows = {f"rows of setups {i} and {j}": (swapped_rows(i, j), "exchanged") for i, j in pairs(count)}
    entries = {f"entries of setups {i} and {j}": (swapped_entries(i, j, *keys), "exchanged") for i, j in pairs(count)}
    return rows | entries


# One wrong sign, a wrong start, a wrong column: what contradicts what, and what is likelier meant.
SLIPPED: dict[str, tuple[Damage, str]] = {
    "readings two rows late": (
        lambda s: with_columns(s, np.roll(s.readings.displacement, 2)),
        "displacement looks shifted by 2 rows down",
    ),
    "degrees Fahrenheit": (fahrenheit, "these look like degrees Fahrenheit"),
}
SIGNED: dict[str, tuple[Damage, str]] = {
    f"sign {j} of diagonal {k}": (
        entry("setups", k, direction=lambda d, j=j: tuple(-v if i == j else v for i, v in enumerate(d))),
        "off the run that start, direction, step and blocks state, one of",
    )
    for k in range(3)
    for j in range(3)
} | {
    f"signs {i} and {j} of diagonal {k} exchanged": (
        entry("setups", k, direction=lambda d, i=i, j=j: tuple(d[{i: j, j: i}.get(n, n)] for n in range(3))),
        "direction [-1, 1, 1], and stated" if k == 1 else "direction [1, -1, 1], and stated",
    )
    for k, i, j in ((1, 0, 1), (1, 0, 2), (2, 0, 1), (2, 1, 2))
}
BEAM = {
    "azimuth for displacement": (beam_for_reading, "azimuth and displacement look exchanged"),
    "no azimuth": (columns(azimuth=lambda v: 0.0 * v), "off the direction from the stated place of the station"),
    "azimuth from another zero": (columns(azimuth=lambda v: v + 0.17), "azimuth is 0.17 rad too large throughout"),
    "a station that stands metres away": (entry("setups", 0, position=moved(0, 2.0)), "of setup 'A' is"),
    "x twice": (columns(x=lambda v: 2.0 * v), "x looks doubled"),
    "x of the other sign": (columns(x=lambda v: -v), "x looks of the opposite sign"),
    "azimuth in degrees": (columns(azimuth=DEGREES), "degrees"),
    "azimuth clockwise": (columns(azimuth=lambda v: -v), "clockwise"),
}
ENVIRONMENT: dict[str, tuple[Damage, str]] = {
    "a part in hectopascals": (columns(air_pressure=lambda v: np.where(v > np.median(v), v, v / 100)), "hectopascals"),
    "a mark for nothing": (columns(temperature_air=lambda v: np.where(v > v[5], v, -999.0)), "is an empty field"),
}
STATIONS = {"stations in millimetres": (scaled_entries("setups", "position", 1e3), "millimetres")}
TRACKING = UNITS | ENVIRONMENT | SIGNS | SLIPPED | BEAM | STATIONS | swaps(4, "position")
ROTARY = (
    {k: v for k, v in UNITS.items() if "positions" not in k}
    | SIGNS
    | STATIONS
    | SLIPPED
    | {
        "a target that stands metres away": (
            entry("targets", 0, position=moved(0, 2.0)),
            "target 'P' is found 1990 mm off its stated position (position_uncertainty 0.05 mm), the most along x",
        ),
        "a target that stands metres above": (
            entry("targets", 2, position=moved(2, 2.0)),
            "displacement of target 'K' is",
        ),
        "angles twice": (columns(c=lambda v: 2.0 * v), "c looks doubled"),
        "angles of one station from another zero": (
            lambda s: columns(c=lambda v: v + 0.17 * (s.readings.setup == 0))(s),
            "are the angles of all stations the same?",
        ),
        "never read": (displacement(0.0), "was the instrument read?"),
        "angles in degrees": (columns(c=DEGREES), "degrees"),
        "angles of the other sign": (columns(c=lambda v: -v), "other way"),
        "rotation_sign": (turned_round, "other way"),
        "targets in millimetres": (scaled_entries("targets", "position", 1e3), "millimetres"),
        **{f"targets {a} and {b}": (swapped_labels("target", a, b), "exchanged") for a, b in ("PQ", "PK", "QK")},
    }
    | swaps(4, "position")
)
# Found by a fit of all readings, whichever way the axis turned.
FROM_ALL_READINGS = ("a target that stands metres away", "readings two rows late")
DAMAGED: dict[str, dict[str, tuple[Damage, str]]] = {
    "tracking_2d": TRACKING | {"azimuth reversed": (columns(azimuth=lambda v: v - np.pi), "from the target")},
    "tracking_3d": TRACKING
    | {
        "elevation in degrees": (columns(elevation=DEGREES), "degrees"),
        "azimuth off by half a turn": (columns(azimuth=lambda v: v - np.pi), "half a turn"),
    },
    "rotary_axis": ROTARY,
    "rotary_axis_one_way": {name: ROTARY[name] for name in ROTARY if name not in FROM_ALL_READINGS},
    "step_diagonal": UNITS
    | SIGNS
    | SLIPPED
    | SIGNED
    | {
        "x twice": (columns(x=lambda v: 2.0 * v), "x looks doubled"),
        "a start 0.1 m away": (entry("setups", 0, start=moved(1, 0.1)), "places run from [0, 0, 0] to [0.12, 0.12"),
        "a start 1 m outside": (entry("setups", 5, start=moved(2, 1.0)), "is 1000 mm off the run"),
    }
    | {"starts in millimetres": (scaled_entries("setups", "start", 1e3), "millimetres")}
    | {f"rows of setups {i} and {j}": (swapped_rows(i, j), "exchanged") for i, j in pairs(6)}
    | {f"diagonals {i} and {j}": (swapped_entries(i, j, "direction", "start"), "exchanged") for i, j in pairs(3)},
    "step_diagonal_three_orders": UNITS
    | SIGNS
    | {f"rows of setups {i} and {j}": (swapped_rows(i, j), "exchanged") for i, j in pairs(9)[::5]},
    # The sign and the double of a deviation would be as plausible a machine: nothing shows them.
    "probing_cross": UNITS
    | {
        "c in degrees": (columns(c=DEGREES), "degrees"),
        "angles of the setups in degrees": (scaled_entries("setups", "c", 180 / np.pi), "degrees"),
        "c of the other sign": (columns(c=lambda v: -v), "rotation_sign"),
        "all angles of the other sign": (
            all_of(columns(c=lambda v: -v), scaled_entries("setups", "c", -1.0)),
            "other way",
        ),
        "rotation_sign": (turned_round, "other way"),
        "all normals reversed": (scaled_entries("workpiece", "normal", -1.0), "are the normals of workpiece reversed?"),
        "one normal reversed": (
            entry("workpiece", 5, normal=lambda n: tuple(-v for v in n)),
            "the approach (dir_x, dir_y) of point '5' contradicts the outward normal",
        ),
        "x twice": (columns(x=lambda v: 2.0 * v), "x looks doubled"),
        "degrees Fahrenheit": SLIPPED["degrees Fahrenheit"],
        "workpiece in millimetres": (scaled_entries("workpiece", "position", 1e3), "millimetres"),
        "two points": (swapped_labels("point", "3", "40"), "points '3' and '40' look exchanged"),
        **{
            f"setups {i} and {j} with their angles": (
                all_of(swapped_rows(i, j), recorded_at_declared_angle),
                "exchanged",
            )
            for i, j in pairs(3)
        },
    }
    | swaps(3, "c"),
    "probing_pins": {"neighbours": (swapped_labels("point", "2", "3"), "is 8.485 mm off the point that was to be")},
    "iso230_2": UNITS,
    "grid_plate": UNITS,
    "straightness": UNITS,
    "drilled_plate": UNITS,
}


def case(preset: str, name: str) -> Any:
    """Those of a rotary axis that are looked for from many starts take seconds."""
    slow = preset.startswith("rotary_axis") and any(word in name for word in ("metres", "two rows late", "twice"))
    return pytest.param(preset, name, marks=[pytest.mark.long] if slow else [])


@pytest.mark.parametrize(
    ("preset", "name"), [case(preset, name) for preset, cases in DAMAGED.items() for name in cases]
)
def test_damage_is_named(preset: str, name: str) -> None:
    damage, expected = DAMAGED[preset][name]
    session = damage(measured(preset))
    with pytest.raises(CalibrationError) as caught:
        check_session(session)
        identify(session)
    text = str(caught.value)
    assert expected in text
    assert "\n" not in text


@pytest.mark.parametrize(("size", "beside"), [(1.0, 0.023), (0.5, 0.019)])
def test_a_part_may_lie_beside_its_place_by_a_fifth_of_its_radius_or_20_mm(size: float, beside: float) -> None:
    def laid(beside: float) -> Session:
        there = columns(x=lambda v: size * v + beside, y=lambda v: size * v)
        return all_of(there, scaled_entries("workpiece", "position", size))(measured("probing_cross"))

    check_session(laid(beside))
    with pytest.raises(CalibrationError, match=f"is {1e3 * beside + 5:.0f} mm off the point"):
        check_session(laid(beside + 5e-3))


def test_an_axis_across_the_normal_says_nothing_of_the_side_that_was_touched() -> None:
    session = measured("probing_cross")
    readings, points = session.readings, session.description.workpiece
    normal_of = {point.id: point.normal for point in points}
    angle = session.rotation_sign * readings.columns["c"]
    normal = turned(np.array([normal_of[label] for label in readings.labels["point"]]), angle)
    # against the normal, but for the axis that is nearly across it
    sense = np.where(np.abs(normal) < 0.3, 1.0, -1.0) * np.sign(normal)
    nearly = ((np.abs(normal) < 0.3) & (np.abs(normal) > 1e-9)).any(axis=1)
    slanted = columns(dir_x=lambda v: sense[:, 0], dir_y=lambda v: sense[:, 1])(session)
    slanted = slanted.with_readings(slanted.readings.select(nearly))
    check_session(slanted)
    with pytest.raises(CalibrationError, match="are the normals of workpiece reversed"):
        check_session(scaled_entries("workpiece", "normal", -1.0)(slanted))


def _sound(preset: str, count: int) -> Iterator[Session]:
    """Sessions in which nothing is wrong; every second one hides an effect of up to 20 micrometres."""
    method = PRESETS[preset].method
    effects = [flaw.id for flaw in FLAWS.values() if method in flaw.methods]
    for seed in range(count):
        rng = np.random.default_rng(seed)
        hidden = FlawSpec(id=str(rng.choice(effects)), amplitude=float(rng.uniform(2e-6, 2e-5)))
        spec = SimulationSpec(plan=PRESETS[preset], seed=seed, effects=(hidden,) if seed % 2 else ())
        try:
            yield simulate(spec).session
        except CalibrationError:  # an effect that changes nothing in this plan
            yield simulate(spec.model_copy(update={"effects": ()})).session


@pytest.mark.long(but=("tracking_2d", "rotary_axis", "probing_cross"))
@pytest.mark.parametrize("preset", [name for name in DAMAGED if name not in ("straightness", "drilled_plate")])
def test_nothing_is_suspected_of_sound_sessions(preset: str, many: Any) -> None:
    for session in _sound(preset, many.part(0.4).count):
        check_session(session)
        build_model(session)

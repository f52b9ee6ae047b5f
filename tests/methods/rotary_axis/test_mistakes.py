# SPDX-License-Identifier: Apache-2.0
"""Common mistakes are named in one line; a bad fit alone is no mistake.
What the readings do not determine is named, and everything else is given.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.plates import with_columns

from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.rotary_axis.model import build
from machine_tool_calibration.methods.rotary_axis.spec import RotarySpec
from machine_tool_calibration.methods.rotary_axis.start import suppositions
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Place, RotaryAxis
from machine_tool_calibration.session.session import Session

# Enough to tell a mistake.
FEW = tuple(np.radians(np.arange(0.0, 360.0, 40.0)))


def _scaled(factor: float) -> Callable[[Session], Session]:
    return lambda s: s.with_readings(replace(s.readings, displacement=factor * s.readings.displacement))


@pytest.mark.long
@pytest.mark.parametrize(("setups", "where"), [((0, 1, 2, 3), r" \("), ((2,), " in setup 'C'")])
def test_two_targets_exchanged(rotary: SimpleNamespace, setups: tuple[int, ...], where: str) -> None:
    session = rotary.measured(2, angles=FEW).session
    names = session.readings.labels["target"].astype(str)
    exchanged = np.where(names == "P", "K", np.where(names == "K", "P", names))
    target = np.where(np.isin(session.readings.setup, setups), exchanged, names)
    with pytest.raises(ModelError, match=f"the targets 'K' and 'P' look exchanged{where}"):
        build(session.with_readings(replace(session.readings, labels={"target": target})))


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: with_columns(s, c=np.degrees(s.readings.columns["c"])), "the column c looks like degrees"),
        (_scaled(-1.0), "opposite sign"),
        (lambda s: replace(s, description=s.description.model_copy(update={"rotation_sign": -1})),
         "turned the other way"),
    ],
)  # fmt: skip
def test_wrong_units_and_signs(rotary: SimpleNamespace, change: Callable[[Session], Session], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        build(change(rotary.measured(1, angles=FEW).session))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1e3, "displacement looks like millimetres"),
        (1e6, "displacement looks like micrometres"),
        (-1.0, "displacement has the opposite sign"),
        (2.0, "displacement looks like twice the change of path"),
    ],
)
def test_what_is_suspected_undoes_the_mistake(rotary: SimpleNamespace, factor: float, message: str) -> None:
    session = rotary.measured(1, angles=FEW).session
    undone = {one.what: one.session for one in suppositions(_scaled(factor)(session))}
    (what,) = (what for what in undone if what.startswith(message))
    np.testing.assert_allclose(undone[what].readings.displacement, session.readings.displacement, rtol=1e-15)


def test_a_bad_axis_is_no_mistake(rotary: SimpleNamespace) -> None:
    machine = {"random": {"rotary_translation": 1e-4, "rotary_tilt": 3e-4, "rotary_angle": 5e-4}}
    build(rotary.measured(0, machine).session)


def test_repeats_that_number_the_readings(rotary: SimpleNamespace) -> None:
    """Every run has a single reading, which says nothing: there are too few of them, and no other fault."""
    session = rotary.measured(2, angles=FEW).session
    numbered = session.with_readings(replace(session.readings, repeat=np.arange(len(session.readings))))
    with pytest.raises(ModelError, match="too few readings"):
        identify(numbered)


def _without(session: Session, target: str) -> Session:
    """The session without one target's readings."""
    return session.with_readings(session.readings.select(session.readings.labels["target"] != target))


def test_a_target_lost_at_two_angles(rotary: SimpleNamespace) -> None:
    simulated = rotary.measured(5, noise_factor=0.0, hidden={"P": (1.0, 1.5)})
    result = identify(simulated.session)
    content = result.error_map.content
    angles = np.asarray(content["c"])
    lost = (angles > 1.0) & (angles < 1.5)
    assert lost.sum() == 2
    value, uncertainty = rotary.found(content)
    assert np.isnan(value[:, lost]).all() and np.isnan(uncertainty[:, lost]).all()
    assert np.isfinite(value[:, ~lost]).all()
    assert np.nanmax(np.abs(rotary.difference(simulated, content)[:3])) < 3e-9
    names = {entry.name: entry.why for entry in result.not_determined}
    assert set(names) == {f"{motion}({angle:.6g})" for motion in rotary.motions() for angle in angles[lost]}
    assert "only targets Q and K were read" in names[f"EXC({angles[lost][0]:.6g})"]
    json.dumps(result.document(), allow_nan=False)


def test_an_angle_at_which_every_reading_is_missing_stays_in_the_list(rotary: SimpleNamespace) -> None:
    session = rotary.measured(5).session
    c = session.readings.columns["c"]
    content = identify(session.without(c == np.unique(c)[4], as_lost=True)).error_map.content
    assert len(content["c"]) == 18
    assert np.isnan(content["EZC"][4]) and np.isfinite(np.delete(content["EZC"], 4)).all()


def test_datum_reading_missing(rotary: SimpleNamespace) -> None:
    session = rotary.measured(6, noise_factor=0.0).session
    result = identify(session.without(session.readings.row == 0, as_lost=True))
    assert [entry.row for entry in result.rejected] == [0]
    assert np.isfinite(result.error_map.content["EXC"]).all()


def test_two_targets_name_all_six_and_still_give_their_own_displacements(rotary: SimpleNamespace) -> None:
    simulated = rotary.measured(7)
    result = identify(_without(simulated.session, target="K"))
    value, _ = rotary.found(result.error_map.content)
    assert np.isnan(value).all()
    assert [entry.name for entry in result.not_determined] == rotary.motions()
    assert all("P and Q" in entry.why for entry in result.not_determined)
    error = result.error_map.content["position_error"].reshape(18, 3, 3)
    assert np.isfinite(error[:, :2]).all()
    assert np.isnan(error[:, 2]).all()  # the third target was not there


def test_too_few_angles_say_so_in_one_line(rotary: SimpleNamespace) -> None:
    session = rotary.measured(8, angles=(0.0, 2.0, 4.0)).session
    with pytest.raises(ModelError, match="too few readings: 36 for 36 unknowns") as caught:
        identify(session)
    assert "\n" not in str(caught.value)


def test_a_target_that_one_station_never_sees(rotary: SimpleNamespace) -> None:
    simulated = rotary.measured(9, noise_factor=0.0, repeats=2)
    readings = simulated.session.readings
    gone = (readings.labels["target"] == "Q") & (readings.setup == 1)
    result = identify(simulated.session.with_readings(readings.select(~gone)))
    assert not result.not_determined
    assert np.abs(rotary.difference(simulated, result.error_map.content)[:3]).max() < 5e-9
    assert len([p for p in result.parameters if p.name.endswith("dead_path")]) == 2 * 11


def test_two_targets_from_three_stations_are_not_enough(rotary: SimpleNamespace) -> None:
    """However many angles: the places of the stations stay open."""
    session = _without(rotary.measured(5).session, target="K")
    check_session(session)
    three = session.with_readings(session.readings.select(session.readings.setup != 1))
    with pytest.raises(SessionError, match="two targets from 3 stations leave the places of the stations open"):
        check_session(three)


def test_stations_and_targets_in_one_plane_across_the_axis_tell_no_heights(rotary: SimpleNamespace) -> None:
    session = rotary.measured(5).session
    about = session.description.as_a(RotaryAxis)
    every, place = np.ones(len(session.readings), dtype=bool), Place("session.yaml", "observations.csv")

    def raised(height: float) -> Session:
        """All in the plane but one station, which stands so high above it."""
        stations, targets = (
            tuple(one.model_copy(update={"position": (*one.position[:2], 0.0)}) for one in some)
            for some in (about.setups, about.targets)
        )
        first = stations[0].model_copy(update={"position": (*stations[0].position[:2], height)})
        flat = about.model_copy(update={"setups": (first, *stations[1:]), "targets": targets})
        return replace(session, description=flat)

    with pytest.raises(SessionError, match=r"one plane across the axis, to 1 mm: .* a tenth of the distance off that"):
        RotarySpec().enough(raised(1e-3), every, place)
    RotarySpec().enough(raised(0.3), every, place)

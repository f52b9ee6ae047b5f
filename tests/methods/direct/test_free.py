# SPDX-License-Identifier: Apache-2.0
"""A plate whose places have errors of their own, as of a stage with a zone that is shifted as a whole."""

from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.arrays import rigid_motions
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.direct import free
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.reports.comparison import in_words
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.session.session import Session

SIDE = np.linspace(0.0, 0.4, 9)
PLACES = np.column_stack([*(axis.ravel() for axis in np.meshgrid(SIDE, SIDE)), np.zeros(81)])
SIGMA = 0.25e-6
TERMS = ("EXX", "EYX", "EXY", "EYY", "ECY", "C0Y")


def zone() -> np.ndarray:
    """(81, 3) what no rigid axes do: a quarter of the stage shifted, m."""
    x, y, _ = PLACES.T
    shifted = ((x > 0.21) & (y > 0.21))[:, None] * np.array([4e-6, -2e-6, 0.0])
    return shifted + np.column_stack([2e-6 * np.sin(x / 0.06), 3e-6 * (y > 0.31), 0 * x])


def measured(direct: SimpleNamespace, seed: int, datum: str = "rigid", axes: tuple[int, ...] = (0, 1)) -> Session:
    """Twice, along x and y, of a stage that lies askew on the machine."""
    rng = np.random.default_rng(seed)
    error = zone()
    if datum != "none":
        error = error + rigid_motions(PLACES - 0.2) @ np.array([15e-6, -9e-6, 0, 0, 0, 3e-5])
    at = np.tile(PLACES, (2 * len(axes), 1))
    g = np.repeat(np.eye(3)[list(axes * 2)], 81, axis=0)
    reading = np.sum(np.tile(error, (2 * len(axes), 1)) * g, axis=1) + SIGMA * rng.normal(size=len(at))
    repeat = np.repeat([0, 1], 81 * len(axes))
    return direct.written(at, g, reading, datum=datum, terms=list(TERMS), sigma=SIGMA, repeat=repeat)


def off(error: np.ndarray, axes: list[int]) -> np.ndarray:
    """(81, d) how far a map is from the truth, without shift and turn of the whole."""
    motions = rigid_motions(PLACES)[:, axes][:, :, [0, 1, 5]].reshape(-1, 3)
    left = (error - zone())[:, axes].ravel()
    return (left - motions @ np.linalg.lstsq(motions, left, rcond=None)[0]).reshape(-1, len(axes))


def test_the_map_of_free_places_is_their_mean_and_its_uncertainty_holds(direct: SimpleNamespace) -> None:
    """The plain mean of two readings is off by sigma times the root of a half; U contains 95 % of what it is off by."""
    inside, rms = [], []
    for seed in range(8):
        session = measured(direct, seed)
        found = identify(session, model="free").error_map
        away = off(found.error, [0, 1])
        rms.append(np.sqrt(np.mean(away**2)))
        inside.append(np.mean(np.abs(away) < 2.0 * found.uncertainty[:, :2]))
        assert np.isnan(found.error[:, 2]).all()
    assert np.mean(rms) == pytest.approx(SIGMA / np.sqrt(2.0), rel=0.1)
    assert 0.93 < np.mean(inside) < 0.99
    rigid = off(identify(session).error_map.error, [0, 1])
    assert np.sqrt(np.mean(rigid**2)) > 3.0 * np.mean(rms)


@pytest.mark.parametrize(("datum", "axes"), [("none", (0, 1)), ("offset", (0,)), ("rigid", (1,))])
def test_what_setups_leave_open_is_the_datum(direct: SimpleNamespace, datum: str, axes: tuple[int, ...]) -> None:
    result = identify(measured(direct, 1, datum, axes), model="free")
    away = off(result.error_map.error, list(axes))
    assert np.sqrt(np.mean(away**2)) < SIGMA
    assert np.isfinite(result.error_map.uncertainty[:, list(axes)]).all()
    assert result.joint.p_value > 1e-3
    assert not any(parameter.name.startswith("e") for parameter in result.parameters)


def test_an_effect_beside_free_places_is_in_the_map_of_each_approach(direct: SimpleNamespace) -> None:
    session = measured(direct, 2)
    sense = np.where(session.readings.repeat == 0, 1.0, -1.0)
    reading = session.readings.displacement - 2e-6 * sense * session.readings.column("gx")
    columns = {**session.readings.columns, "dir_x": sense}
    session = session.with_readings(
        type(session.readings)(
            session.readings.setup, session.readings.repeat, reading, columns, {}, session.readings.row
        )
    )
    result = identify_sessions(FitRequest((session,), model="free", effects=("backlash_x",)))
    (size,) = [p for p in result.parameters if p.owner == "backlash_x"]
    assert abs(size.value - 2e-6) < 4.0 * size.standard_uncertainty
    assert len(result.error_map.points) == 2 * 81


def test_identify_says_where_axes_are_not_rigid_and_more_places_than_can_be_are_refused(
    direct: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = measured(direct, 3)
    for model, said in (("rigid_body", True), ("free", False)):
        result = identify(session, model=model)
        told = list(result_parts(result.document(), [session], result))
        assert any("the model free (--model) gives" in part for part in told if isinstance(part, str)) is said
    monkeypatch.setattr(free, "_MOST", 100)
    with pytest.raises(ModelError, match="the model 'free' takes 50 places at most, and 81 were read"):
        identify(session, model="free")


def test_repeats_are_told_though_the_model_is_of_the_places_themselves(direct: SimpleNamespace) -> None:
    session = measured(direct, 4)
    told = in_words(compare(identify(session, model="free")))
    pairs = session.readings.displacement.reshape(2, 162)
    scatter = float(np.sqrt(np.mean(np.diff(pairs, axis=0) ** 2) / 2.0))
    assert f"Readings repeated at one place scatter {1e6 * scatter:.3f} µm" in told


def test_several_sessions_have_tables_which_they_can_share(direct: SimpleNamespace) -> None:
    sessions = (measured(direct, 5), measured(direct, 6))
    with pytest.raises(ModelError, match="none of the sessions has a model 'free'; known are rigid_body"):
        identify_sessions(FitRequest(sessions, ("a", "b"), model="free"))

# SPDX-License-Identifier: Apache-2.0
"""Several wrong readings of one point: told where the others agree, doubtful where nothing tells."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.problem import LinearPart, group_rows
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.residuals.gross_error_sets import Bulk, compared_sets, groups_of_unknowns
from machine_tool_calibration.residuals.gross_errors import find_outliers
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

# Four stations read a point in space twice; nothing but the sum of their readings tells of an error in one of them.
STATIONS = np.array([[0.9, 0.3, 0.3], [-0.3, 0.9, 0.3], [0.3, -0.3, 0.9], [-0.5, -0.7, 0.5]])
LOCAL = np.concatenate([STATIONS, STATIONS])
NOISE = np.array([0.4, -0.9, 0.2, 0.5, -0.3, 0.8, -0.6, 0.1])


def explained(
    local: Array, residual: Array, limit: float = 4.7, sound: tuple[int, ...] = ()
) -> tuple[IntArray, IntArray]:
    """Readings of a point that nothing else is known of; the limit falls with the share of gross errors."""
    free = np.eye(len(local)) - local @ np.linalg.pinv(local)
    known = np.isin(np.arange(len(local)), sound)
    return compared_sets(free, free @ residual, Bulk(1.0, 200.0, limit, 0.5 * limit**2), known)


def test_three_of_eight_are_told_from_one_another() -> None:
    residual = NOISE.copy()
    residual[[0, 1, 2]] += [170.0, -990.0, 105.0]
    found = explained(LOCAL, residual)
    assert found[0].tolist() == [0, 1, 2]
    assert not len(found[1])


def test_either_of_two_where_no_third_tells() -> None:
    residual = NOISE[[0, 1, 2, 4]].copy()
    residual[3] += 50.0
    found = explained(LOCAL[[0, 1, 2, 4]], residual)
    assert found[1].tolist() == [0, 3]


def test_one_of_four_stations_read_once_leaves_all_in_doubt() -> None:
    residual = NOISE[:4].copy()
    residual[2] += 80.0
    found = explained(STATIONS, residual)
    assert found[1].tolist() == [0, 1, 2, 3]


def test_which_of_two_is_told_where_one_is_known_to_be_sound() -> None:
    residual = NOISE[[0, 1, 2, 4]].copy()
    residual[3] += 50.0
    found = explained(LOCAL[[0, 1, 2, 4]], residual, sound=(0,))
    assert found[0].tolist() == [3]
    assert not len(found[1])


def test_sound_readings_are_all_kept() -> None:
    found = explained(LOCAL, NOISE)
    assert not len(found[0])


def test_one_that_explains_by_chance_what_two_did_better() -> None:
    """Two wrong readings leave nearly what a single other one would: nothing tells which, and all are named."""
    rng = np.random.default_rng(3)
    local = rng.normal(size=(12, 6))
    # What the first two leave, as nearly as they can, of an error in the seventh, off by 3.8 times the scatter.
    free = np.eye(12) - local @ np.linalg.pinv(local)
    pair, single = free[:, [0, 1]], free[:, [6]]
    residual = pair @ np.linalg.lstsq(pair, single[:, 0], rcond=None)[0]
    residual *= 3.8 / np.linalg.norm(residual - single @ np.linalg.lstsq(single, residual, rcond=None)[0])
    found = explained(local, residual)
    assert {0, 1, 6} <= set(found[1].tolist())


def test_the_more_readings_are_wrong_the_more_is_in_doubt() -> None:
    """Where hardly any reading is wrong, the fewest that explain it are; where many are, others may be together."""
    residual = NOISE.copy()
    residual[[0, 1]] += [20.0, -25.0]
    assert not len(explained(LOCAL, residual, limit=4.9)[1])
    assert len(explained(LOCAL, residual, limit=2.5)[1])


def test_six_of_many() -> None:
    """Not all combinations are compared, but those that the likeliest of fewer readings grow into."""
    rng = np.random.default_rng(4)
    residual = rng.normal(size=24) + np.where(np.arange(24) < 6, 50.0 * (1 + np.arange(24)), 0.0)
    assert explained(np.ones((24, 1)), residual, limit=3.5)[0].tolist() == list(range(6))


def test_readings_that_see_the_same_unknowns_are_compared_with_each_other() -> None:
    """Five unknowns: two that share a reading, one of a single reading, one of all 40, one by itself."""
    n, columns = 40, np.zeros((5, 40))
    columns[0, 0:3], columns[1, 2:5], columns[2, 7], columns[3], columns[4, 20:24] = 1.0, -2.0, 1.0, 1.0, 0.5
    rows, blocks, none = group_rows(np.zeros(n, dtype=np.int64)), np.zeros((1, 0), dtype=np.int64), np.zeros((0, n))
    part = LinearPart(rows, np.zeros(n), np.full(n, 1e-6), none, none, columns, blocks, np.arange(5))
    found = groups_of_unknowns(part, (np.zeros(5), np.zeros((1, 0))), 5)
    assert [group.tolist() for group in found] == [[0, 1, 2, 3, 4], [20, 21, 22, 23]]


def test_wrong_readings_that_agree_with_each_other_do_not_win() -> None:
    """Two stations off so that together they hardly show: the sound repeats beside them do not take their place."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_3d"], seed=5)).session
    readings = session.readings
    place = np.stack([readings.columns[a] for a in "xyz"])
    mine = np.flatnonzero((np.abs(place - place[:, [31]]) < 1e-9).all(axis=0))
    first = [int(mine[readings.setup[mine] == s][0]) for s in range(3)]
    change = np.zeros(len(readings))
    change[first] = [76.5e-6, 298e-6, -31.6e-6]
    wrong = session.with_readings(replace(readings, displacement=readings.displacement + change))
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    assert {o.row for o in found} == {int(readings.row[k]) for k in first}

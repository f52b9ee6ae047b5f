# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of places that were read once each: axes one at a time, and a machine that is no three rigid axes."""

from types import ModuleType

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.search.structure import structure_candidates
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session


def in_space(plates: ModuleType, position: np.ndarray, error: np.ndarray, terms: list[str], declared: float) -> Session:
    """Places (n, 3), m, and their deviations (n, 3) read along x, y and z."""
    n = len(position)
    columns = dict(zip("xyz", np.repeat(position, 3, axis=0).T, strict=True))
    columns |= dict(zip(("gx", "gy", "gz"), np.tile(np.eye(3), (n, 1)).T, strict=True))
    columns["displacement"] = error.reshape(-1)
    return plates.session(columns, declared, "rigid", terms, np.zeros(3 * n), "tracker")


def test_axes_that_cross_in_the_middle_of_their_travel_have_no_product(plates: ModuleType) -> None:
    """A tracker at a stage of which one axis moves at a time, the others at zero."""
    along = np.linspace(-0.2, 0.2, 11)
    position = np.concatenate([along[:, None] * axis for axis in np.eye(3)])
    rng = np.random.default_rng(1)
    error = 1e-4 * position + 2e-5 * rng.normal(size=position.shape)
    session = in_space(plates, position, error, ["EXX", "EYY", "EZZ"], 2e-5)
    pool = Pool(fit_models([build_model(session)[0]]))
    assert all(len(shaped.columns) for one in structure_candidates(pool) for shaped in one.shapes)
    assert diagnose(session).verdict in ("adequate", "missing_effect", "unexplained")


def places_of_arm(joints: np.ndarray) -> np.ndarray:
    """(n, 3) where an arm with two links ends that turns on a column, from its three angles (n, 3)."""
    turn, lift, bend = joints.T
    reach = 0.3 * np.cos(lift) + 0.35 * np.cos(lift + bend)
    height = 0.3 * np.sin(lift) + 0.35 * np.sin(lift + bend)
    return np.column_stack([reach * np.cos(turn), reach * np.sin(turn), height])


def test_what_explains_a_small_part_of_a_pattern_is_not_what_is_missing(plates: ModuleType) -> None:
    """The errors of a jointed arm are those of its joints, of which error motions of three axes take up a little."""
    rng = np.random.default_rng(4)
    joints = np.column_stack([rng.uniform(-1.0, 1.0, 250), rng.uniform(0.3, 1.5, 250), rng.uniform(-2.2, -0.4, 250)])
    turn, lift, bend = joints.T
    off = 1e-3 * np.column_stack([np.sin(2 * turn + 3 * lift), 0.8 * np.sin(3 * lift), 0.8 * np.cos(2 * bend + turn)])
    error = places_of_arm(joints + off) - places_of_arm(joints)
    noise = 3e-5 * rng.normal(size=error.shape)
    session = in_space(plates, np.round(places_of_arm(joints), 5), error + noise, ["EXX", "EYY", "EZZ"], 3e-5)
    found = diagnose(session)
    assert any(found.search.of(name).probability > 0.9 for name in found.search.accepted)
    assert found.fits[0].reduced_chi_square > 50.0
    assert (found.verdict, found.accepted) == ("unexplained", ())

# SPDX-License-Identifier: Apache-2.0
"""Position errors against the truth: their size is as stated."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify


def _judged(direct: SimpleNamespace, kind: str, runs: int, **plan: Any) -> tuple[float, float, float]:
    """Mean squared normalised error, RMS error over the stated one, and mean reduced chi-square."""
    normalised, errors, stated, chi = [], [], [], []
    for seed in range(runs):
        simulated = direct.measured(kind, seed, **plan)
        result = identify(simulated.session)
        content = result.error_map.content
        points = content["points"]
        sensed = np.abs(result.fit.model.observations.direction).max(axis=0) > 0.5
        error = (content["position_error"] - simulated.truth.machine.position_error(points))[:, sensed]
        uncertainty = content["position_error_u"][:, sensed]
        if simulated.session.description.datum == "rigid":
            error = direct.fitted_out(error, direct.rigid_motions(points)[:, sensed])
        elif simulated.session.description.datum == "offset":
            error = error - error.mean()
        there = uncertainty > 1e-12
        normalised.append(np.mean((error[there] / uncertainty[there]) ** 2))
        errors.append(np.mean(error**2))
        stated.append(np.mean(uncertainty**2))
        chi.append(result.fit.joint.reduced_chi_square)
    return float(np.mean(normalised)), float(np.sqrt(np.mean(errors) / np.mean(stated))), float(np.mean(chi))


@pytest.mark.parametrize(
    ("kind", "plan"),
    [("iso230_2", {"repeats": 3}), ("iso230_2", {"repeats": 3, "datum": "offset"}), ("straightness", {"repeats": 3})],
)
def test_lines_over_many_runs(direct: SimpleNamespace, kind: str, plan: dict[str, Any], many: Any) -> None:
    normalised, ratio, chi = _judged(direct, kind, many.count, **plan)
    assert normalised == pytest.approx(1.0, abs=many.off(0.1))
    assert ratio < 1.0 + many.off(0.1)
    assert chi == pytest.approx(1.0, abs=many.off(0.05))


def test_grid_over_some_runs(direct: SimpleNamespace, many: Any) -> None:
    some = many.part(0.6)
    normalised, ratio, chi = _judged(direct, "grid_plate", some.count, misplacement=1e-5)
    assert normalised == pytest.approx(1.0, abs=some.off(0.05))
    assert ratio < 1.0 + some.off(0.05)
    assert chi == pytest.approx(1.0, abs=some.off(0.025))


def test_part_that_lies_milliradians_askew(direct: SimpleNamespace) -> None:
    # The second order of the turn, 3 um over the plate, would pass for a scale.
    side = np.linspace(0.0, 0.4, 6)
    place = np.array([(x, y, 0.0) for y in side for x in side])
    actual = place * (1.0 + 1e-5)
    turn = 4e-3
    c, s = np.cos(turn), np.sin(turn)
    seen = actual @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + [3e-4, -2e-4, 0.0]
    reading = np.concatenate([(seen - place)[:, 0], (seen - place)[:, 1]])
    g = np.concatenate([np.tile(np.eye(3)[0], (36, 1)), np.tile(np.eye(3)[1], (36, 1))])
    session = direct.written(np.tile(place, (2, 1)), g, reading, datum="rigid")
    (scale,) = (p for p in identify(session, effects=["scale"]).parameters if p.name == "scale.s")
    assert scale.value == pytest.approx(1e-5, abs=5e-8)

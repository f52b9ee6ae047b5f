# SPDX-License-Identifier: Apache-2.0
"""Are the stated uncertainties of a step diagonal right, whatever the machine's angular errors?

Simulated sessions of random machines, fitted with the default model: the mean of ((map - truth) / u)^2, which is 1
where the uncertainties are right, and the map's error over the uncertainty that the model `translations` states, which
takes the angles to be zero. Turns of the whole map, which the measurement leaves open, do
not count.

    python benchmarks/step_diagonal_uncertainty.py --sessions 200 --output docs/step_diagonal.md
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl
from in_order import in_order

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.methods.step_diagonal.profiles import Profiles, eq17
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.simulation import (
    Amplitudes,
    DiagonalPlan,
    MachineSpec,
    Simulated,
    SimulationSpec,
    simulate,
)

_ANGLES = (0.0, 1e-6, 2e-6, 5e-6, 1e-5)
_FIRST_SEED = 9000
_THREE: dict[str, Any] = {"orders": ("xyz", "yzx", "zxy"), "repeats": 1}


@dataclass(frozen=True)
class Case:
    """A plan, and the machine's guideways: `knots` nodes of the errors' splines (3: smooth, 13: rough)."""

    words: str
    plan: DiagonalPlan
    knots: int = 7


_CUBE = DiagonalPlan(step=(0.03,) * 3)
_BOX: dict[str, Any] = {"step": (0.05, 0.03, 0.02), "blocks": 10, "corner": (-0.2, 0.1, -0.15)}
CASES = (
    Case("120 mm, 12 steps", DiagonalPlan()),
    Case("120 mm, 12 steps, three orders", DiagonalPlan(**_THREE)),
    Case("600 mm, 12 steps", DiagonalPlan(step=(0.05,) * 3)),
    Case("600 mm, 12 steps, three orders", DiagonalPlan(step=(0.05,) * 3, **_THREE)),
    Case("200 mm, 5 steps", DiagonalPlan(step=(0.04,) * 3, blocks=5)),
    Case("500 x 300 x 200 mm off zero, 10 steps", DiagonalPlan(**_BOX)),
    Case("360 mm, 12 steps, noise 0.5 um", _CUBE.model_copy(update={"noise": 5e-7})),
    Case("360 mm, 12 steps, smooth guideways", _CUBE, knots=3),
    Case("360 mm, 12 steps, rough guideways", _CUBE, knots=13),
)


def simulated(case: Case, angular: float, seed: int) -> Simulated:
    """A session of a random machine whose nine angular errors are at most `angular`."""
    size = Amplitudes(positioning=1.5e-6, straightness=1.5e-6, angular=angular, squareness=3e-5, knots=case.knots)
    return simulate(SimulationSpec(plan=case.plan, seed=seed, machine=MachineSpec(random=size)))


def _turn_free(blocks: tuple[Array, Array, Array]) -> Array:
    """Projector off common rotations of all profiles."""
    along = np.concatenate([np.kron(b - b[0], axis).reshape(-1, 3) for axis, b in zip(np.eye(3), blocks, strict=True)])
    columns = np.column_stack([np.cross(w, along).ravel() for w in np.eye(3)])
    return np.asarray(np.eye(len(columns)) - columns @ np.linalg.pinv(columns))


def _fitted(model: StepDiagonalModel) -> Profiles:
    return model.profiles(fit_models([model]).fits[0])


def figures(item: tuple[Case, float, int]) -> tuple[float, float, float]:
    """Mean squared normalised error, its standard error, and the map's RMS error over that stated without angles."""
    case, angular, sessions = item
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        bound = _fitted(build(simulated(case, angular, _FIRST_SEED).session, "translations"))
        free = _turn_free(bound.blocks)
        smallest = np.trace(free @ bound.covariance @ free.T)
        normalised, square = [], []
        for seed in range(_FIRST_SEED, _FIRST_SEED + sessions):
            one = simulated(case, angular, seed)
            profiles = _fitted(build(one.session))
            judged = one.truth.expected["axis_errors"]
            true = eq17(profiles.blocks, np.concatenate([np.ravel(judged[letter]) for letter in "xyz"]))
            error = free @ (profiles.value - true)
            variance = np.diag(free @ profiles.covariance @ free.T)
            known = variance > 1e-20
            normalised.append(np.mean(error[known] ** 2 / variance[known]))
            square.append(np.sum(error**2))
    scatter = np.std(normalised, ddof=1) / np.sqrt(sessions)
    return float(np.mean(normalised)), float(scatter), float(np.sqrt(np.mean(square) / smallest))


_TEXT = """# Step diagonal: are the uncertainties right?

The default model, `small_angles`, takes the machine's angular errors for small random functions whose size the
readings tell (`methods/step_diagonal/small_angles.py` has the assumptions). This is how it does on {sessions} simulated
machines each, whose nine angular errors are at most so large over the measured travel
(`python benchmarks/step_diagonal_uncertainty.py`). Unless said otherwise the noise is 0.1 um, one order of moves, two
repeats.

Mean of ((map - truth) / u)^2; 1 where the uncertainties are right. The mean over {sessions} sessions is itself
uncertain by {scatter:.2f} (median over the table).

| plan | {head} |
|---|{rule}|
{normalised}
| **geometric mean** | {mean} |

They cannot be right for each size by itself. Where the angular errors are too small to show in the readings the model
cannot know whether they are there; it states what is right on the average over machines with and without them. For a
machine without angular errors the uncertainties are then some 7 % too large (0.88). They are up to 15 % too small
(1.33) for one whose errors are just too small to be seen, and up to 19 % (1.42) if its guideways are so smooth that the
angles are hardly more than a slope and a bow, which look like straightness.

RMS error of the map, over the uncertainty that the model `translations` states, which takes the angles to be zero:

| plan | {head} |
|---|{rule}|
{rms}
"""


def document(found: dict[tuple[str, float], tuple[float, float, float]], sessions: int) -> str:
    """The tables in Markdown."""
    head = " | ".join("none" if a == 0 else f"{1e6 * a:g} urad" for a in _ANGLES)
    words = [case.words for case in CASES]

    def rows(pick: int) -> str:
        return "\n".join(f"| {w} | " + " | ".join(f"{found[w, a][pick]:.2f}" for a in _ANGLES) + " |" for w in words)

    means = [np.exp(np.mean([np.log(found[w, a][0]) for w in words])) for a in _ANGLES]
    return _TEXT.format(
        sessions=sessions,
        scatter=float(np.median([value[1] for value in found.values()])),
        head=head,
        rule="|".join(["---:"] * len(_ANGLES)),
        normalised=rows(0),
        mean=" | ".join(f"{value:.2f}" for value in means),
        rms=rows(2),
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2, help="processes of this machine; 0: none, without Dask")
    parser.add_argument("--scheduler", help="of a Dask cluster, instead of processes of this machine")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    work = list(product(CASES, _ANGLES))
    found: dict[tuple[str, float], tuple[float, float, float]] = {}
    items = [(case, angular, asked.sessions) for case, angular in work]
    several = in_order(figures, items, workers=asked.workers, scheduler=asked.scheduler)
    for (case, angular), one in zip(work, several, strict=True):
        mean, scatter, rms = found[case.words, angular] = one
        print(f"{case.words}, {1e6 * angular:g} urad: {mean:.2f} +- {scatter:.2f}, RMS {rms:.2f}", flush=True)
    text = document(found, asked.sessions)
    if asked.output is None:
        print(text)
    else:
        asked.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

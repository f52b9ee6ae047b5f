# SPDX-License-Identifier: Apache-2.0
"""Are the uncertainties of the published map right, also where readings are not ideal?

Simulated sessions of random machines with nothing hidden: the mean of ((map - map of the same machine from readings
without noise) / u)^2 over all values of the map, which is 1 where the uncertainties are right. Read with white noise,
with slopes and bows of the setups, with a declared uncertainty three times too small, and with 5 % of gross errors.

    python benchmarks/map_uncertainty.py --sessions 40 --output docs/map_uncertainty.md
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import threadpoolctl
from in_order import in_order

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, Spread, simulate

_PLANS = (
    "tracking_2d", "tracking_3d", "step_diagonal", "rotary_axis", "rotary_axis_one_way", "probing_cross", "probing_cam",
    "iso230_2", "grid_plate",
)  # fmt: skip
_KINDS = ("white", "spread", "noise x 3", "gross errors")
_FIRST_SEED = 3000
# Slopes and bows of the setups, and gross errors, in standard uncertainties of a reading; the share of gross errors.
_SPREAD, _GROSS, _GROSS_SHARE = (0.3, 2.0), (10.0, 100.0), 0.05
# An uncertainty below this, m or rad, is that of a value that the datum sets.
_SET = 1e-12

Values = dict[tuple[object, ...], tuple[float, float]]


def published(result: Result) -> Values:
    """Every value of the map with its standard uncertainty, by name and place."""
    document = result.document()["error_map"]
    points = [tuple(np.round(point, 7)) for point in document.get("points", ())]
    angles = list(np.round(document.get("c", ()), 9))
    out: Values = {}
    for name, values in document.items():
        if f"{name}_u" not in document or not np.ndim(values):
            continue
        value, u = np.array(values, dtype=float), np.array(document[f"{name}_u"], dtype=float)
        # What was set aside may take a place out of the list.
        places = next((where for where in (points, angles) if len(where) == len(value)), range(len(value)))
        for at in np.ndindex(value.shape):
            if u[at] > _SET:
                out[name, places[at[0]], *at[1:]] = float(value[at]), float(u[at])
    return out


def made(plan: str, kind: str, seed: int) -> Session:
    """A session with what the kind says."""
    spec = SimulationSpec(plan=PRESETS[plan], seed=seed)
    sigma, rng = simulate(spec).session.sigma, np.random.default_rng([seed, 7])
    if kind == "spread":
        size = float(sigma * rng.uniform(*_SPREAD))
        spec = spec.model_copy(update={"spread": Spread(slope=size, bow=size)})
    if kind == "noise x 3":
        spec = spec.model_copy(update={"noise_factor": 3.0})
    session = simulate(spec).session
    if kind == "gross errors":
        readings = session.readings
        displacement = readings.displacement.copy()
        hit = rng.choice(len(readings), max(1, round(_GROSS_SHARE * len(readings))), replace=False)
        displacement[hit] += sigma * rng.uniform(*_GROSS, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
        session = session.with_readings(replace(readings, displacement=displacement))
    return session


def normalised(case: tuple[str, str, int]) -> float:
    """The mean square of a session's normalised errors."""
    plan, kind, seed = case
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        result = identify(made(plan, kind, seed))
        silent = simulate(SimulationSpec(plan=PRESETS[plan], seed=seed, noise_factor=0.0)).session
        # Without the same readings: the datum is that of the places which the readings determine.
        gone = np.isin(silent.readings.row, [entry.row for entry in result.rejected])
        true = published(identify(silent.without(gone, as_lost=True), keep_all=True))
        found = published(result)
    return float(np.mean([((value - true[key][0]) / u) ** 2 for key, (value, u) in found.items() if key in true]))


_TEXT = """# Are the uncertainties of the map right?

Mean of ((map - truth) / u)^2 over all values of the map of {sessions} simulated sessions each, with the standard
uncertainty of that mean, and the sessions' median where it differs by more than a quarter; 1 where the uncertainties
are right (`python benchmarks/map_uncertainty.py`). "Spread": slopes and bows of the instrument's setups of 0.3 to 2
standard uncertainties of a reading; "noise x 3": three times what is declared; "gross errors": 5 % of the readings are
wrong by 10 to 100 standard uncertainties. Truth is the map of the same machine from the same readings without noise.

| plan | {head} |
|---|{rule}|
{rows}

Where the mean is far above the median, a place or an angle is wrong in a few of the sessions: a wrong reading hides
where other readings hardly tell of it, less than a few standard uncertainties of its own being left in its residual.
Where several wrong readings may as well be others, what differs is set aside, and the place may be lost.
[The step diagonal](step_diagonal.md) has a page for angular errors of every size.
"""


def entry(values: list[float]) -> str:
    """Mean, its uncertainty, and the median where it tells another story."""
    mean, middle = float(np.mean(values)), float(np.median(values))
    text = f"{mean:.2f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.2f}"
    return text if abs(mean - middle) < 0.25 else f"{text} (median {middle:.2f})"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=40)
    parser.add_argument("--plans", nargs="*", default=list(_PLANS))
    parser.add_argument("--workers", type=int, default=2, help="processes of this machine; 0: none, without Dask")
    parser.add_argument("--scheduler", help="of a Dask cluster, instead of processes of this machine")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    seeds = range(_FIRST_SEED, _FIRST_SEED + asked.sessions)
    cases = list(product(asked.plans, _KINDS, seeds))
    values = in_order(normalised, cases, workers=asked.workers, scheduler=asked.scheduler)
    found = dict(zip(cases, values, strict=True))
    rows = [
        f"| {plan} | " + " | ".join(entry([found[plan, kind, seed] for seed in seeds]) for kind in _KINDS) + " |"
        for plan in asked.plans
    ]
    rule = "|".join(["---:"] * len(_KINDS))
    text = _TEXT.format(sessions=asked.sessions, head=" | ".join(_KINDS), rule=rule, rows="\n".join(rows))
    if asked.output is None:
        print(text)
    else:
        asked.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

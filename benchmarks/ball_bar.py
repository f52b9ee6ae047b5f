# SPDX-License-Identifier: Apache-2.0
"""Which causes of a ball bar's circles are named, in simulated machines with one to four of them.

Machines with random squareness, centre and bar, circles in XY or in three planes, both ways round at two feeds. Every
cause is as large as its published uncertainty says: in the fit with all the hidden ones its best determined coefficient
is so many standard uncertainties (6 are three times its U). Truth serves for judging alone: named is a cause that was
accepted, itself or by one of a group of at most four that these circles do not tell apart; wrong is any other effect
that was accepted.

Beside it an oracle: it knows which causes may be hidden, the exact signal of each (its lead, frequency and reach) but
for the size, the noise, and that all else reproduces. It takes the set that explains most, where every cause costs what
one of so many does not explain by chance in 99 of 100 machines. What it misses nobody can name.

    python benchmarks/ball_bar.py --trials 200 --size 6
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from broken_worlds import Outcome, judge_effects
from scipy.stats import chi2
from worlds import ALIKE, World, inner_products, machining, with_change

from machine_tool_calibration.diagnosis.improve import improve
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

_OF_AXES = ("backlash", "lost_motion", "servo_mismatch", "reversal_spike", "pitch_periodic", "vibration")
CAUSES = (*(f"{kind}_{axis}" for kind in _OF_AXES for axis in "xy"),
          "reversal_EYX", "reversal_EXY", "EYX", "EXY", "linear_drift")  # fmt: skip
PLANS = ("ball_bar", "ball_bar_three_planes")
# Most causes in a set of the oracle.
_MOST = 5


@dataclass(frozen=True)
class Trial:
    """One machine: how many causes, what was said of them, and what the oracle says."""

    count: int
    outcome: Outcome
    off: tuple[float, ...]  # sizes found less true ones, in their U
    oracle_named: bool
    oracle_right: bool


def sized(world: World, size: float) -> World:
    """The same causes, each with a coefficient of so many standard uncertainties beside all the others."""
    names, readings = list(world.signals), world.session.readings
    seen = world.showing(names)
    fit = fit_models([add_effects(build_model(seen)[0], find_effects(names))]).fits[0]
    u, ratio = np.sqrt(np.diag(fit.covariance)), dict.fromkeys(names, 0.0)
    for parameter, value, own, good in zip(fit.model.parameters, fit.theta, u, fit.determined, strict=True):
        if parameter.owner in ratio and parameter.reference == 0.0 and good:
            ratio[parameter.owner] = max(ratio[parameter.owner], abs(value) / own)
    signals = {name: np.asarray(signal) * size / ratio[name] for name, signal in world.signals.items()}
    noise = readings.displacement - seen.readings.displacement
    assert world.silent is not None
    return replace(world, session=with_change(world.silent, sum(signals.values()) + noise), signals=signals)


def oracle(world: World, number: int, plan: str) -> tuple[bool, bool]:
    """Whether the set that explains most holds all hidden causes, and no other; look-alikes count as the same."""
    assert world.silent is not None
    quiet = SimulationSpec(plan=PRESETS[plan], seed=number, noise_factor=0.0)
    laws = dict(world.signals)
    for name in set(CAUSES).difference(laws):
        flawed = simulate(quiet.model_copy(update={"effects": (FlawSpec(id=name, amplitude=3e-6),)})).session
        laws[name] = flawed.readings.displacement - world.silent.readings.displacement
    names = sorted(laws)
    read = world.session.readings.displacement - world.silent.readings.displacement
    fit = fit_models([build_model(world.silent)[0]]).fits[0]
    inner = inner_products(fit, [*(np.asarray(laws[name]) for name in names), read])
    kept = [k for k in range(len(names)) if inner[k, k] > 1e-6]
    price = float(chi2.isf(0.01 / len(kept), 1))

    def score(members: Sequence[int]) -> float:
        own = list(members)
        right = inner[own, -1]
        return float(right @ np.linalg.lstsq(inner[np.ix_(own, own)], right, rcond=1e-9)[0]) - price * len(own)

    sets = (own for count in range(1, _MOST + 1) for own in combinations(kept, count))
    best = max(sets, key=score)
    norm = np.sqrt(np.diag(inner))
    alike = np.abs(inner) > ALIKE * np.outer(norm, norm)
    hidden = [names.index(name) for name in world.signals]
    named = all(any(alike[h, k] for k in best) for h in hidden)
    return named, all(any(alike[h, k] for h in hidden) for k in best)


def trial(number: int, count: int, size: float) -> Trial | None:
    """One machine; None where no such causes can be hidden in it."""
    plan = PLANS[number // 4 % len(PLANS)]
    outcome = Outcome("ball bar", number, plan)
    try:
        world = sized(machining(plan, number, sizes=(size,) * count, names=CAUSES), size)
    except CalibrationError:
        return None
    outcome.hidden = " ".join(world.listed)
    start = time.process_time()
    done = improve(world.session)
    outcome.seconds = time.process_time() - start
    judge_effects(world, outcome, done, improvement_document(done)["accepted"])
    named, right = oracle(world, number, plan)
    return Trial(count, outcome, _off(world, done.steps[-1].result), named, right)


def _off(world: World, result: object) -> tuple[float, ...]:
    """Coefficients of hidden causes that were named, less those of a fit of what these alone change, in their U."""
    parameters = {p.name: p for p in result.sizes(result.effects)}  # type: ignore[attr-defined]
    names = [name for name in result.effects if name in world.signals]  # type: ignore[attr-defined]
    if not names:
        return ()
    seen = world.showing(names)
    fit = fit_models([add_effects(build_model(seen)[0], find_effects(names))]).fits[0]
    out = []
    for parameter, value in zip(fit.model.parameters, fit.theta, strict=True):
        found = parameters.get(parameter.name)
        if found is not None and found.standard_uncertainty:
            out.append((found.value - parameter.reference - value) / (2.0 * found.standard_uncertainty))
    return tuple(out)


def table(trials: Sequence[Trial]) -> str:
    """Shares by number of causes."""
    lines = [
        "| causes | machines | all named % | none wrong % | within U % | oracle: all named % | oracle: none wrong % "
        "| processor s |",
        "|---:|" + "---:|" * 7,
    ]
    for count in sorted({one.count for one in trials}):
        mine = [one for one in trials if one.count == count]
        off = np.concatenate([one.off for one in mine])
        shares = (
            np.mean([bool(one.outcome.named) for one in mine]),
            np.mean([not one.outcome.wrong for one in mine]),
            np.mean(np.abs(off) <= 1.0) if len(off) else np.nan,
            np.mean([one.oracle_named for one in mine]),
            np.mean([one.oracle_right for one in mine]),
        )
        cells = [f"{100.0 * share:.0f}" if np.isfinite(share) else "" for share in shares]
        lines.append(
            f"| {count} | {len(mine)} | {' | '.join(cells)} | {np.median([o.outcome.seconds for o in mine]):.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--size", type=float, default=6.0, help="standard uncertainties (default: 6)")
    given = parser.parse_args()
    trials: list[Trial] = []
    for number in range(given.first_seed, given.first_seed + given.trials):
        one = trial(number, 1 + number % 4, given.size)
        if one is None:
            continue
        trials.append(one)
        said = one.outcome
        marks = "WRONG " * bool(said.wrong) + "MISSED " * (not said.named)
        marks += "(oracle WRONG) " * (not one.oracle_right) + "(oracle MISSED)" * (not one.oracle_named)
        within = f"{sum(abs(off) <= 1.0 for off in one.off)} of {len(one.off)} within U"
        print(number, said.plan, said.hidden, "->", said.accepted, marks, within, flush=True)
    print(table(trials))


if __name__ == "__main__":
    main()

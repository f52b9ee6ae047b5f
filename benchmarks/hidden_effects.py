# SPDX-License-Identifier: Apache-2.0
"""How often is a hidden effect found, called by its right name, and the map put right?

Simulated sessions of random machines: with nothing hidden (with and without a spread between setups), with one hidden
effect (beside gross errors, too), with two, with one that is in no catalogue, and an axis run by ISO 230-2 with warm-up
and backlash. The simulator calculates readings from geometry and shares no formula with the estimator.

    python benchmarks/hidden_effects.py --trials 40 --output rates.md
"""

from __future__ import annotations

import argparse
import time
import zlib
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import threadpoolctl

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.diagnosis.search.candidates import effect_candidates
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models, screen
from machine_tool_calibration.model.result import EffectSet
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import FLAWS, PRESETS, Chips, FlawSpec, SimulationSpec, Spread, simulate

# Largest change of a reading by which an effect is tried at first, m.
_TRIED = 3e-6
# An effect that must change a reading by more than this to be seen, m, counts as absorbed by the model.
_LARGEST = 1.5e-5
# An unlisted effect that a listed one reproduces to this cosine cannot be known to be another.
_ALIKE = 0.9
# Two effects are told apart where their signals outside the model have at most this cosine.
_APART = 0.5
# Slopes and bows between setups, in standard uncertainties of a reading: drawn anew for every session.
_SPREAD = (0.3, 2.0)
# So many of the readings are wrong by 20 to 60 um.
_GROSS = Chips(fraction=0.03)
_PLANS = ("tracking_2d", "tracking_3d", "step_diagonal", "rotary_axis", "probing_cross")
_SIGNALS = {
    "one at 10 with spread": 10.0,
    "one at 6": 6.0,
    "two at 12": 12.0,
    "one at 15 with gross errors": 15.0,
    "unlisted at 15": 15.0,
}
_AXIS = ("iso230_2", ("warmup_x", "backlash_x"))
_LISTED = tuple(name for name in FLAWS if not name.startswith("unlisted") and not name.endswith("C"))
_UNLISTED = tuple(name for name in FLAWS if name.startswith("unlisted"))
_VERDICTS = ("missing_effect", "unexplained", "adequate")


@dataclass(frozen=True)
class Trial:
    """One simulated session to be diagnosed."""

    kind: str
    plan: str
    effects: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What was said of a session.

    Attributes:
        verdict: of the diagnosis; empty where the session was left out.
        first: whether the effects, or effects confounded with them, come first in the ranking.
        found: whether they, or effects confounded with them, were accepted.
        exact: whether they themselves were accepted, and nothing else.
        before: error of the map with the effect in the data, over its error without.
        after: the same with what was accepted in the model.
        known: the same with what is hidden in the model: nothing that is found can be expected to do better.
    """

    trial: Trial
    verdict: str = ""
    accepted: tuple[str, ...] = ()
    ranked: tuple[str, ...] = ()
    first: bool = False
    found: bool = False
    exact: bool = False
    before: float = np.nan
    after: float = np.nan
    known: float = np.nan
    seconds: float = 0.0
    note: str = ""

    @property
    def wrong(self) -> bool:
        """Whether the verdict is not what it should be."""
        if self.trial.effects in {(name,) for name in _UNLISTED}:
            return self.verdict != "unexplained"
        return not self.found if self.trial.effects else self.verdict != "adequate"


def signal_outside_model(clean: Session, change: Array) -> float:
    """Norm of a change of the readings, outside the model's freedom, in standard uncertainties."""
    fit = fit_models([build_model(clean)[0]]).fits[0]
    keep = np.isfinite(clean.readings.displacement)
    return float(np.sqrt(max(screen(fit, change[keep][None]).gram[0, 0], 0.0)))


def looks_listed(clean: Session, change: Array) -> bool:
    """Whether an effect of the catalogue reproduces this signal outside the model."""
    fit = fit_models([build_model(clean)[0]]).fits[0]
    candidates, _ = effect_candidates(Pool(fit.joint), list(catalogue().values()))
    for candidate in candidates:
        for shaped in candidate.shapes:
            projected = screen(fit, np.concatenate([shaped.columns, change[None]]))
            scale = np.sqrt(np.maximum(projected.squares[:-1], 1e-300))
            inner = projected.gram[:-1, :-1] / np.outer(scale, scale)
            right = inner[:-1, -1]
            seen = right @ np.linalg.pinv(inner[:-1, :-1], rcond=1e-4, hermitian=True) @ right
            if seen > _ALIKE**2 * inner[-1, -1]:
                return True
    return False


def flaw(base: SimulationSpec, effect: str, signal: float) -> FlawSpec:
    """An effect whose signal outside the model is as large as wanted.

    Raises:
        CalibrationError: the model takes it up, it does not act in this plan, or it looks like another.
    """
    silent = base.model_copy(update={"noise_factor": 0.0, "effects": (), "spread": Spread(), "chips": None})
    clean = simulate(silent).session
    if effect in catalogue():
        joint = fit_models([build_model(clean)[0]])
        _, excluded = effect_candidates(Pool(joint), [catalogue()[effect]])
        if excluded:
            raise CalibrationError(f"{effect} does not act here: {excluded[effect]}")
        if any(term.name.endswith(f".{effect}") for term in joint.assembly.models[0].terms):
            raise CalibrationError(f"the model has {effect} already, as a random function")
    tried = FlawSpec(id=effect, amplitude=_TRIED)
    changed = simulate(silent.model_copy(update={"effects": (tried,)})).session
    change = changed.readings.displacement - clean.readings.displacement
    strength = signal_outside_model(clean, change)
    if _TRIED * signal > _LARGEST * strength:
        raise CalibrationError(f"{effect}: {strength:.2f} standard uncertainties from a change of {_TRIED * 1e6:g} um")
    if effect in _UNLISTED and looks_listed(clean, change):
        raise CalibrationError(f"{effect} looks like a listed effect")
    return FlawSpec(id=effect, amplitude=_TRIED * signal / strength)


def run(trial: Trial) -> Outcome:
    """Simulate, diagnose, and look at the map; a session that cannot be made is left out with the reason."""
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        base = SimulationSpec(plan=PRESETS[trial.plan], seed=trial.seed)
        sigma = simulate(base).session.sigma
        if trial.kind == "warm-up and backlash":
            return _of_axis(trial, base)
        if "spread" in trial.kind:
            size = sigma * float(np.random.default_rng([trial.seed, 1]).uniform(*_SPREAD))
            base = base.model_copy(update={"spread": Spread(slope=size, bow=size)})
        if "gross" in trial.kind:
            base = base.model_copy(update={"chips": _GROSS})
        try:
            flaws = tuple(flaw(base, effect, _SIGNALS[trial.kind]) for effect in trial.effects)
        except CalibrationError as error:
            return Outcome(trial, note=str(error))
        session = simulate(base.model_copy(update={"effects": flaws})).session
        start = time.perf_counter()
        found = diagnose(session)
        seconds = time.perf_counter() - start
        outcome = _judged(trial, found, seconds)
        if trial.kind.startswith(("one", "two")):
            # Published is the map over the sets of effects that the diagnosis holds possible, as `improve` does it.
            added = (found.accepted, found.sets if found.accepted else ())
            before, after, known = map_ratios(base, session, (((), ()), added, (trial.effects, ())))
            outcome = replace(outcome, before=before, after=after, known=known)
        return outcome


def _of_axis(trial: Trial, base: SimulationSpec) -> Outcome:
    """The pattern of real axes: warm within a part of the run, and lost motion."""
    rng = np.random.default_rng(trial.seed)
    length = float(np.ptp(simulate(base).session.readings.columns["time"]))
    size = float(rng.uniform(1e-6, 2e-6))
    flaws = (
        FlawSpec(id="warmup_x", amplitude=float(rng.uniform(4e-6, 8e-6)), parameters={"tau": length / 3.0}),
        FlawSpec(id="backlash_x", size=size),
    )
    session = simulate(base.model_copy(update={"effects": flaws})).session
    start = time.perf_counter()
    found = diagnose(session)
    return _judged(trial, found, time.perf_counter() - start)


def _judged(trial: Trial, found: Diagnosis, seconds: float) -> Outcome:
    groups = [set(group) for group in found.look.groups]
    alike = {e: {e}.union(*(group for group in groups if e in group)) for e in trial.effects}
    ranked = tuple(r.candidate.name for r in found.ranked)
    return Outcome(
        trial=trial,
        verdict=found.verdict,
        accepted=found.accepted,
        ranked=ranked[:3],
        first=bool(trial.effects) and all(alike[e] & set(ranked[: len(trial.effects)]) for e in trial.effects),
        found=bool(trial.effects) and all(alike[e] & set(found.accepted) for e in trial.effects),
        exact=bool(trial.effects) and set(trial.effects) == set(found.accepted),
        seconds=seconds,
    )


def map_ratios(
    base: SimulationSpec, session: Session, models: Sequence[tuple[tuple[str, ...], tuple[EffectSet, ...]]]
) -> list[float]:
    """Error of the map with some effects in the model, over its error in a session without any hidden effect.

    The reference is the map of the same machine from readings without noise and hidden effects, so that all have the
    same datum; errors count in standard uncertainties of the session without a hidden effect.

    Args:
        base: the machine and the plan.
        session: the session with the hidden effects.
        models: effects that are in each model, and the sets over which its map is the mean; none for its own alone.

    Returns:
        One ratio for each; NaN where the session does not determine the model.
    """
    silent = base.model_copy(update={"noise_factor": 0.0, "effects": (), "spread": Spread(), "chips": None})
    reference, _ = _map(simulate(silent).session, ())
    without, uncertainty = _map(simulate(base.model_copy(update={"effects": (), "chips": None})).session, ())

    def error(values: Array) -> float:
        return float(np.sqrt(np.nanmean(((values - reference) / uncertainty) ** 2)))

    ratios = []
    for effects, sets in models:
        try:
            ratios.append(error(_map(session, effects, sets)[0]) / error(without))
        except CalibrationError:
            ratios.append(np.nan)
    return ratios


def _map(session: Session, effects: tuple[str, ...], sets: Sequence[EffectSet] = ()) -> tuple[Array, Array]:
    values = identify(session, effects=effects, sets=sets).document()["error_map"]
    names = [name for name in values if f"{name}_u" in values]
    arrays = [np.asarray(values[name], dtype=float).ravel() for name in names]
    stated = [np.asarray(values[f"{name}_u"], dtype=float).ravel() for name in names]
    uncertainty = np.concatenate(stated)
    return np.concatenate(arrays), np.where(uncertainty > 0, uncertainty, np.nan)


def pairs(plan: str) -> list[tuple[str, str]]:
    """Effects that a plan can show and tell from each other, one random machine taken for all."""
    base = SimulationSpec(plan=PRESETS[plan], seed=1, noise_factor=0.0)
    clean = simulate(base).session
    names, changes = [], []
    for effect in _LISTED:
        try:
            one = flaw(base, effect, _SIGNALS["two at 12"])
        except CalibrationError:
            continue
        names.append(effect)
        changed = simulate(base.model_copy(update={"effects": (one,)})).session
        changes.append(changed.readings.displacement - clean.readings.displacement)
    fit = fit_models([build_model(clean)[0]]).fits[0]
    inner = screen(fit, np.array(changes)).gram[:-1, :-1]
    norm = np.sqrt(np.diag(inner))
    apart = np.abs(inner) <= _APART * np.outer(norm, norm)
    return [(names[i], names[j]) for i in range(len(names)) for j in range(i) if apart[i, j]]


def trials(count: int, plans: tuple[str, ...], kinds: tuple[str, ...]) -> list[Trial]:
    """What to run."""
    out = []
    if "warm-up and backlash" in kinds:
        out += [Trial("warm-up and backlash", _AXIS[0], _AXIS[1], seed) for seed in range(max(count // 4, 1))]
    for plan in plans:
        for kind in (kind for kind in kinds if kind != "warm-up and backlash"):
            if kind in ("none", "spread"):
                chosen: Sequence[tuple[str, ...]] = [()] * count
            elif kind.startswith("two"):
                rng = np.random.default_rng(zlib.crc32(plan.encode()))
                possible = pairs(plan)
                chosen = [possible[k] for k in rng.integers(len(possible), size=count)] if possible else []
            else:
                names = _UNLISTED if kind.startswith("unlisted") else _LISTED
                # Every effect as often; fewer sessions than effects are some of them.
                many = [(effect,) for effect in names] * max(count // 10, 1)
                rng = np.random.default_rng(zlib.crc32(f"{plan} {kind}".encode()))
                chosen = many if count >= 10 else [many[k] for k in rng.permutation(len(many))[:count]]
            for k, effects in enumerate(chosen):
                seed = zlib.crc32(f"{plan} {kind} {effects} {k}".encode()) % 10**6
                out.append(Trial(kind, plan, effects, seed))
    return out


def table(outcomes: list[Outcome]) -> str:
    """Markdown table of the rates."""
    lines = [
        "| data | plan | sessions | ranked first | found | exact | "
        + " | ".join(_VERDICTS)
        + " | outliers | map before | map after | map if known |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    by: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        if outcome.verdict:
            by[outcome.trial.kind, outcome.trial.plan].append(outcome)
            by[outcome.trial.kind, "all"].append(outcome)
    kinds = list(dict.fromkeys(outcome.trial.kind for outcome in outcomes))
    for (kind, plan), group in sorted(by.items(), key=lambda item: (kinds.index(item[0][0]), item[0][1])):
        n = len(group)
        shown = kind.startswith(("one", "two", "warm"))
        rates = [sum(getattr(o, name) for o in group) if shown else "" for name in ("first", "found", "exact")]
        verdicts = [sum(o.verdict == v for o in group) for v in (*_VERDICTS, "outliers")]
        ratios = [
            f"{np.nanmedian([getattr(o, name) for o in group]):.2f}" if shown and kind[:4] != "warm" else ""
            for name in ("before", "after", "known")
        ]
        lines.append("| " + " | ".join(str(v) for v in (kind, plan, n, *rates, *verdicts, *ratios)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--trials", type=int, default=4, help="sessions of a plan and kind; from 10 on as many of every effect as tens"
    )
    parser.add_argument("--plans", nargs="*", default=list(_PLANS))
    parser.add_argument("--kinds", nargs="*", default=["none", "spread", *_SIGNALS, "warm-up and backlash"])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--failures", action="store_true", help="print every session that went wrong")
    options = parser.parse_args()
    work = trials(options.trials, tuple(options.plans), tuple(options.kinds))
    with ProcessPoolExecutor(options.workers) as pool:
        outcomes = list(pool.map(run, work, chunksize=4))
    text = table(outcomes)
    print(text)
    print(
        f"\n{sum(not o.verdict for o in outcomes)} left out; slowest diagnosis {max(o.seconds for o in outcomes):.1f} s"
    )
    for o in outcomes:
        if options.failures and o.verdict and o.wrong:
            t = o.trial
            print(t.kind, t.plan, *t.effects, t.seed, "->", o.verdict, *o.accepted, "ranked", *o.ranked)
    if options.output:
        options.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

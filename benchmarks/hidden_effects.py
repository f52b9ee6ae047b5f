"""How often is a hidden effect found, called by its right name, and the map put right?

Simulated sessions of random machines: with one hidden effect, with two, with none (with and without a spread between
setups), and with one that is in no catalogue. The simulator calculates readings from geometry and shares no formula
with the estimator.

    python benchmarks/hidden_effects.py --trials 20 --output docs/hidden_effects.md
"""

from __future__ import annotations

import argparse
import time
import zlib
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machine_tool_calibration.diagnosis.candidates import effect_candidates
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.fit import fit_models, screen
from machine_tool_calibration.simulation import FLAWS, PRESETS, FlawSpec, SimulationSpec, Spread, simulate

# An effect that must be this large to be seen, m, counts as absorbed by the model.
_LARGEST = 1.5e-5
# An unlisted effect that a listed one reproduces to this cosine cannot be known to be another.
_ALIKE = 0.9
_HEADER = "| plan | data | sessions | missing_effect | right group | exact effect | unexplained | adequate | other |"
_PLANS = ("tracking_2d", "tracking_3d", "step_diagonal", "rotary_axis", "probing_cross")


@dataclass(frozen=True)
class Trial:
    """One simulated session and what was said of it."""

    kind: str
    plan: str
    effects: tuple[str, ...]
    signal: float
    seed: int
    verdict: str = ""
    accepted: tuple[str, ...] = ()
    first: str = ""
    groups: tuple[tuple[str, ...], ...] = ()
    seconds: float = 0.0
    note: str = ""


def signal_outside_model(spec: SimulationSpec) -> float:
    """Norm of what an effect changes in the readings, outside the model's freedom, in standard uncertainties."""
    with_effect = simulate(spec.model_copy(update={"noise_factor": 0.0})).session
    without = simulate(spec.model_copy(update={"noise_factor": 0.0, "effects": ()})).session
    change = with_effect.readings.displacement - without.readings.displacement
    fit = fit_models([build_model(without)[0]]).fits[0]
    keep = np.isfinite(without.readings.displacement)
    return float(np.sqrt(max(screen(fit, change[keep][None]).gram[0, 0], 0.0)))


def looks_listed(spec: SimulationSpec) -> bool:
    """Whether an effect of the catalogue reproduces this one's signal outside the model."""
    with_effect = simulate(spec.model_copy(update={"noise_factor": 0.0})).session
    without = simulate(spec.model_copy(update={"noise_factor": 0.0, "effects": ()})).session
    change = (with_effect.readings.displacement - without.readings.displacement)[None]
    fit = fit_models([build_model(without)[0]]).fits[0]
    candidates, _ = effect_candidates(fit.model.observations, list(catalogue().values()))
    for candidate in candidates:
        for block in candidate.blocks:
            projected = screen(fit, np.concatenate([block.columns, change]))
            scale = np.sqrt(np.maximum(projected.squares[:-1], 1e-300))
            inner = projected.gram[:-1, :-1] / np.outer(scale, scale)
            right = inner[:-1, -1]
            seen = right @ np.linalg.pinv(inner[:-1, :-1], rcond=1e-4, hermitian=True) @ right
            if seen > _ALIKE**2 * inner[-1, -1]:
                return True
    return False


def run(trial: Trial) -> Trial:
    """Simulate and diagnose."""
    plan = PRESETS[trial.plan]
    spread = Spread()
    base = SimulationSpec(plan=plan, seed=trial.seed)
    sigma = simulate(base.model_copy(update={"noise_factor": 0.0})).session.sigma
    if trial.kind == "spread" or trial.kind.endswith("with spread"):
        spread = Spread(slope=0.4 * sigma, bow=0.4 * sigma)
    flaws = []
    known, observations = catalogue(), build_model(simulate(base).session)[0].observations
    for effect in trial.effects:
        if effect in known and known[effect].why_not(observations):
            return _with(trial, verdict="absorbed", note="does not act in this plan")
        one = base.model_copy(update={"effects": (FlawSpec(id=effect, amplitude=3e-6),)})
        strength = signal_outside_model(one)
        if 3e-6 * trial.signal / max(strength, 1e-9) > _LARGEST:
            return _with(
                trial, verdict="absorbed", note=f"{strength:.2f} standard uncertainties from an amplitude of 3 um"
            )
        if trial.kind.startswith("unlisted") and looks_listed(one):
            return _with(trial, verdict="absorbed", note="looks like a listed effect")
        flaws.append(FlawSpec(id=effect, amplitude=3e-6 * trial.signal / strength))
    session = simulate(base.model_copy(update={"effects": tuple(flaws), "spread": spread})).session
    start = time.perf_counter()
    found = diagnose(session, seed=trial.seed + 1)
    seconds = time.perf_counter() - start
    ranked = found.ranked
    return _with(
        trial,
        verdict=found.verdict,
        accepted=found.accepted,
        first=ranked[0].candidate.name if ranked else "",
        groups=tuple(group for look in found.looks for group in look.groups),
        seconds=seconds,
    )


def _with(trial: Trial, **changes: object) -> Trial:
    return Trial(**{**trial.__dict__, **changes})  # type: ignore[arg-type]


def safe(trial: Trial) -> Trial:
    """A failure is a result too."""
    try:
        return run(trial)
    except CalibrationError as error:
        verdict = "absorbed" if "does not occur" in str(error) or "changes no reading" in str(error) else "error"
        return _with(trial, verdict=verdict, note=str(error))


def in_group(trial: Trial, effect: str) -> bool:
    """Whether the effect, or one that the diagnosis said it cannot be told from, was accepted."""
    alike = {effect} | {name for group in trial.groups if effect in group for name in group}
    return any(name in alike for name in trial.accepted)


def trials(count: int, plans: tuple[str, ...]) -> list[Trial]:
    """What to run."""
    out = []
    listed = [name for name in FLAWS if not name.startswith("unlisted") and not name.endswith("C")]
    unlisted = [name for name in FLAWS if name.startswith("unlisted")]
    for plan in plans:
        for kind in ("none", "spread"):
            out += [Trial(kind, plan, (), 0.0, zlib.crc32(f"{plan}{kind}{k}".encode()) % 10**6) for k in range(count)]
        for effect in listed:
            for kind, signal in (("one at 10", 10.0), ("one at 6", 6.0), ("one at 10 with spread", 10.0)):
                for k in range(max(count // 10, 1)):
                    out.append(
                        Trial(kind, plan, (effect,), signal, zlib.crc32(f"{plan}{effect}{kind}{k}".encode()) % 10**6)
                    )
        for effect in unlisted:
            for k in range(max(count // 5, 1)):
                out.append(
                    Trial("unlisted at 15", plan, (effect,), 15.0, zlib.crc32(f"{plan}{effect}{k}".encode()) % 10**6)
                )
        rng = np.random.default_rng(zlib.crc32(plan.encode()))
        pairs = [name for name in listed if not name.startswith("E")]
        for k in range(count):
            pair = tuple(str(name) for name in rng.choice(pairs, 2, replace=False))
            out.append(Trial("two at 12", plan, pair, 12.0, 1000 + k))
    return out


def table(results: list[Trial]) -> str:
    """Markdown tables of the rates."""
    lines = [
        _HEADER,
        "|---|---|---|---|---|---|---|---|---|",
    ]
    by: dict[tuple[str, str], list[Trial]] = defaultdict(list)
    for trial in results:
        if trial.verdict not in ("absorbed",):
            by[trial.plan, trial.kind].append(trial)
            by["all", trial.kind].append(trial)
    for (plan, kind), group in sorted(by.items()):
        n = len(group)
        right = sum(all(in_group(t, e) for e in t.effects) for t in group if t.effects)
        exact = sum(set(t.effects) <= set(t.accepted) for t in group if t.effects)
        verdicts = [sum(t.verdict == v for t in group) for v in ("missing_effect", "unexplained", "adequate")]
        lines.append(
            "| "
            + " | ".join(str(v) for v in (plan, kind, n, verdicts[0], right, exact, *verdicts[1:], n - sum(verdicts)))
            + " |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--plans", nargs="*", default=list(_PLANS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--failures", action="store_true", help="print every session that went wrong")
    options = parser.parse_args()
    work = trials(options.trials, tuple(options.plans))
    with ProcessPoolExecutor(options.workers) as pool:
        results = list(pool.map(safe, work, chunksize=4))
    text = table(results)
    print(text)
    print(f"\nslowest diagnosis {max(t.seconds for t in results):.1f} s")
    for trial in results:
        if trial.verdict == "absorbed":
            continue
        wrong = (
            trial.effects
            and trial.kind.startswith(("one", "two"))
            and not all(in_group(trial, e) for e in trial.effects)
        )
        wrong = (
            wrong
            or (not trial.effects and trial.verdict != "adequate")
            or (trial.kind.startswith("unl") and trial.verdict != "unexplained")
        )
        if options.failures and wrong:
            print(
                trial.kind,
                trial.plan,
                trial.effects,
                trial.seed,
                "->",
                trial.verdict,
                trial.accepted,
                trial.first,
                trial.note,
            )
    if options.output:
        options.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

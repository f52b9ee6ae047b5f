# SPDX-License-Identifier: Apache-2.0
"""How long a measurement that ends when it is enough takes, beside the fixed plan that comes with the package.

    python benchmarks/until.py --machines 8 --first-seed 500

Each simulated machine is measured by the fixed plan to its end, and as `mtcal run --until` does it up to the same
largest U that the fixed plan came to, rounded up to two digits; or until it is told whether Y has a backlash, which
half of the machines have. The fixed plan, too, ends as soon as it is enough, at the end of one of its setups. Times are
those of motion and waiting with the time to put up each setup (`choices.mounting`). What both measure of a setup has
the same noise, so that luck does not decide. Beside them stands the forecast: the time of the quickest plan that
exchange finds to the U that is foretold of the fixed one, which nothing but luck or more stops falls below.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from machine_tool_calibration.arrays import Array, first_of_group
from machine_tool_calibration.budget.enough import Reached, Until, after_each_setup, determined, reached
from machine_tool_calibration.budget.patterns import shared_errors
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.step_diagonal.geometry import runs_of
from machine_tool_calibration.nodes.measurement import site_document, stage_of
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.best_plan import all_candidates, quickest_plan
from machine_tool_calibration.planning.forecast import Assumed, planned_session
from machine_tool_calibration.planning.offer import Choice, offer
from machine_tool_calibration.planning.optimise import quickest
from machine_tool_calibration.procedure import Procedure, parse_procedure, plan, read_procedure
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import Probing, RotaryAxis, StationSetup, StepDiagonal
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation.site import Site, SiteSpec
from machine_tool_calibration.simulation.spec import FlawSpec

KINDS = {
    "tracking_2d": "U",
    "step_diagonal": "U",
    "rotary_axis_one_way": "U",
    "probing_cross": "U",
    "tracking_2d, backlash": "told=backlash_y",
}


@dataclass(frozen=True)
class Compared:
    """Seconds to the same end by the fixed plan and by the chosen one."""

    kind: str
    seed: int
    fixed: float
    until: float
    enough: bool
    goal: str

    @property
    def ratio(self) -> float:
        """Of the times; of a measurement that was not enough after its last setup, the whole of it."""
        return self.until / self.fixed


def seconds(stages: list[Reached] | tuple[Reached, ...], mounting: float) -> tuple[float, bool]:
    """Time until it was enough, and whether it was."""
    last = next((k for k, one in enumerate(stages) if one.enough), len(stages) - 1)
    mounted = len({one.setup for one in stages[: last + 1]})
    return (stages[last].seconds or 0.0) + mounting * mounted, stages[last].enough


def added(procedure: Procedure, site: Site, session: Session) -> Array:
    """(n,) what the machine's errors and where things stand add to the readings, m; nothing to touches of a part."""
    description, steps = session.description, plan(procedure).steps
    out = np.zeros(len(steps))
    if isinstance(description, Probing):
        return out
    beams = [run.beam for run in runs_of(description)] if isinstance(description, StepDiagonal) else []
    for k, step in enumerate(steps):
        index = int(session.readings.setup[k])
        now = site.moment(float(session.readings.columns["time"][k]), step.position, step.direction)
        aim = np.array(step.aim)
        if isinstance(description, StepDiagonal):
            out[k] = (site.functional_point(now)[0] - aim) @ beams[index]
            continue
        setup, station = description.setups[index], site.station(description, index)
        assert isinstance(setup, StationSetup)
        if isinstance(description, RotaryAxis):
            target = step.target or 0
            there = site.on_table(now, site.target(description.targets[target], target))[0]
        else:
            there = site.functional_point(now)[0]
        out[k] = np.linalg.norm(there - station) - np.linalg.norm(aim - np.array(setup.position))
    return out


def measured(procedure: Procedure, site: Site) -> Session:
    """A session of the procedure with noise that depends on site, setup and repeat alone."""
    session, steps = planned_session(procedure), plan(procedure).steps
    readings, description, spec = session.readings, session.description, method_spec(procedure.session.method)
    sigma = description.standard_uncertainty.displacement
    change = added(procedure, site, session)
    change -= sigma * np.random.default_rng(0).normal(size=len(steps))  # its own noise is taken away
    for which in sorted({(step.setup, step.repeat) for step in steps}):
        mine = np.array([(step.setup, step.repeat) == which for step in steps])
        stream = np.random.default_rng([site.spec.seed, *which[0].encode(), which[1]])
        change[mine] += sigma * stream.normal(size=mine.sum())
    if not spec.reads_deviations:
        runs = (readings.repeat,) if spec.counts_from_run else ()
        targets = (readings.labels["target"].astype(str),) if "target" in readings.labels else ()
        change -= change[first_of_group(readings.setup, *runs, *targets)]
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


def after_each_stage(procedure: Procedure, session: Session, goal: Until) -> list[Reached]:
    """What is known after each stage, up to the one that is enough."""
    every, found = stage_of(procedure), []
    wanted = 1 if goal.u is None else determined(FitRequest((planned_session(procedure),)))
    setup = session.readings.setup
    begin = np.flatnonzero(np.diff(setup, prepend=-1))
    for first, end in zip(begin, [*begin[1:], len(setup)], strict=True):
        for stop in [*range(first + every, end, every), end]:
            part = session.with_readings(session.readings.select(np.arange(stop)))
            found.append(reached(FitRequest((part,)), goal, wanted))
            if found[-1].enough:
                return found
    return found


@cache
def first(kind: str, goal: Until) -> Procedure:
    """The plan with which `--until` sets out."""
    file, u = procedure_file(kind.partition(",")[0]), None if goal.u is None else goal.u / 2
    text = quickest_plan(file.read_text(), file.name, Assumed(errors=shared_errors), u=u, told=goal.told)
    return parse_procedure(text, file.name)


def foretold(kind: str) -> float:
    """Time of the quickest plan that is found to the U that is foretold of the fixed plan, over that plan's."""
    file = procedure_file(kind)
    offered = offer(file.read_text(), file.name)
    candidates, _, _ = all_candidates(offered, Assumed(errors=shared_errors), ())

    def largest(choice: Choice) -> float:
        return float(np.sqrt(candidates.variances(offered.weights(choice))[candidates.told].max()))

    goal = largest(offered.present) * (1.0 + 1e-9)
    found = quickest(offered, candidates, goal, lambda what, share: None)
    begun = (replace(found, setups=found.setups[:n]) for n in range(1, len(found.setups) + 1))
    soonest = next(choice for choice in begun if largest(choice) <= goal)
    return offered.duration(soonest) / offered.duration(offered.present)


def compared(kind: str, seed: int) -> Compared:
    """One machine."""
    file = procedure_file(kind.partition(",")[0])
    procedure = read_procedure(file)
    mounting = procedure.choices.mounting
    hidden = (FlawSpec(id="backlash_y"),) if KINDS[kind] != "U" and seed % 2 else ()
    site = Site(SiteSpec.model_validate(site_document(procedure, SiteSpec(seed=seed, effects=hidden))))
    asked = FitRequest((measured(procedure, site),))
    if KINDS[kind] == "U":
        end = list(after_each_setup(asked, Until(u=1.0)))[-1]
        digit = 10.0 ** (np.floor(np.log10(end.u)) - 1.0)
        goal = Until(u=float(np.ceil(end.u / digit) * digit))
    else:
        goal = Until.parse(KINDS[kind])
    fixed, _ = seconds(list(after_each_setup(asked, goal)), mounting)
    chosen = first(kind, goal)
    until, enough = seconds(after_each_stage(chosen, measured(chosen, site), goal), mounting)
    return Compared(kind, seed, fixed, until, enough, KINDS[kind] if goal.u is None else f"U = {1e6 * goal.u:.3g} um")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=8, help="of each kind")
    parser.add_argument("--first-seed", type=int, default=500)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    chosen = parser.parse_args()

    def every() -> Iterator[Compared]:
        for kind in chosen.kinds:
            for seed in range(chosen.first_seed, chosen.first_seed + chosen.machines):
                found = compared(kind, seed)
                lost = "" if found.enough else ", not enough"
                print(
                    f"{kind} {seed}: {found.goal}, fixed {found.fixed / 60:.0f} min, until {found.until / 60:.0f} min "
                    f"({found.ratio:.2f}{lost})",
                    flush=True,
                )
                yield found

    done = list(every())
    print("\n| procedure | machines | ratio of times: median | least | largest | not enough | foretold |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for kind in [*chosen.kinds, ""]:
        some = [one for one in done if kind in ("", one.kind)]
        ratios = np.array([one.ratio for one in some])
        lost = sum(not one.enough for one in some)
        print(
            f"| {kind or 'all'} | {len(some)} | {np.median(ratios):.2f} | {ratios.min():.2f} | {ratios.max():.2f} "
            f"| {lost} | {f'{foretold(kind):.2f}' if KINDS.get(kind) == 'U' else ''} |"
        )


if __name__ == "__main__":
    main()

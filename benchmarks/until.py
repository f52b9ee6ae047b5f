# SPDX-License-Identifier: Apache-2.0
"""How long a measurement that ends when it is enough takes, beside the fixed plan that comes with the package.

    python benchmarks/until.py --machines 8 --first-seed 500

Each simulated machine is measured through the graph: by the fixed plan to its end, and by `mtcal run --until` up to
the same largest U that the fixed plan came to, rounded up to two digits; or until it is told whether Y has a backlash,
which half of the machines have. The fixed plan, too, ends as soon as it is enough, at the end of one of its setups.
Times are those of motion and waiting with the time to put up each setup (`choices.mounting`).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from machine_tool_calibration.budget.enough import Reached, Until, after_each_setup
from machine_tool_calibration.budget.patterns import shared_errors
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes.measurement import Setting, measure
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.best_plan import Assumed, quickest_plan
from machine_tool_calibration.procedure import parse_procedure, read_procedure
from machine_tool_calibration.simulation.site import SiteSpec
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


def compared(kind: str, seed: int, folder: Path) -> Compared:
    """One machine."""
    file = procedure_file(kind.partition(",")[0])
    procedure = read_procedure(file)
    mounting = procedure.choices.mounting
    hidden = (FlawSpec(id="backlash_y"),) if KINDS[kind] != "U" and seed % 2 else ()
    site = SiteSpec(seed=seed, effects=hidden)
    whole = measure(file, Setting(folder / "fixed", site, record=False, identify=False)).session
    asked = FitRequest((whole,))
    if KINDS[kind] == "U":
        end = list(after_each_setup(asked, Until(u=1.0)))[-1]
        digit = 10.0 ** (np.floor(np.log10(end.u)) - 1.0)
        goal = Until(u=float(np.ceil(end.u / digit) * digit))
    else:
        goal = Until.parse(KINDS[kind])
    fixed, _ = seconds(list(after_each_setup(asked, goal)), mounting)
    assumed = Assumed(errors=shared_errors)
    text = quickest_plan(file.read_text(), file.name, assumed, u=None if goal.u is None else goal.u / 2, told=goal.told)
    chosen = folder / f"{parse_procedure(text, file.name).name}.yaml"
    chosen.write_text(text)
    run = measure(chosen, Setting(folder / "until", site, record=False, identify=False, until=goal))
    until, enough = seconds(run.reached, mounting)
    return Compared(kind, seed, fixed, until, enough, KINDS[kind] if goal.u is None else f"U = {1e6 * goal.u:.3f} um")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=8, help="of each kind")
    parser.add_argument("--first-seed", type=int, default=500)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    chosen = parser.parse_args()

    def every() -> Iterator[Compared]:
        for kind in chosen.kinds:
            for seed in range(chosen.first_seed, chosen.first_seed + chosen.machines):
                with TemporaryDirectory() as folder:
                    found = compared(kind, seed, Path(folder))
                lost = "" if found.enough else ", not enough"
                print(
                    f"{kind} {seed}: {found.goal}, fixed {found.fixed / 60:.0f} min, until {found.until / 60:.0f} min "
                    f"({found.ratio:.2f}{lost})",
                    flush=True,
                )
                yield found

    done = list(every())
    print("\n| procedure | machines | ratio of times: median | least | largest | not enough |")
    print("|---|---:|---:|---:|---:|---:|")
    for kind in [*chosen.kinds, ""]:
        some = [one for one in done if kind in ("", one.kind)]
        ratios = np.array([one.ratio for one in some])
        lost = sum(not one.enough for one in some)
        print(
            f"| {kind or 'all'} | {len(some)} | {np.median(ratios):.2f} | {ratios.min():.2f} | {ratios.max():.2f} "
            f"| {lost} |"
        )


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""Which causes of a ball bar's circles are named, in simulated machines with one to four of them.

Machines with random squareness, centre and bar, circles in XY both ways round or in three planes. Every cause is of the
size at which it changes the readings by so many standard uncertainties outside the model (6 are three times its U),
beside the others. Truth serves for judging alone: named is a cause that was accepted, itself or by one of a group of at
most four that these circles do not tell apart; wrong is any other effect that was accepted.

    python benchmarks/ball_bar.py --trials 200 --size 6
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from broken_worlds import Outcome, judge
from worlds import machining

from machine_tool_calibration.errors import CalibrationError

_OF_AXES = ("backlash", "lost_motion", "servo_mismatch", "reversal_spike", "pitch_periodic")
CAUSES = (*(f"{kind}_{axis}" for kind in _OF_AXES for axis in "xy"),
          "reversal_EYX", "reversal_EXY", "EYX", "EXY", "linear_drift")  # fmt: skip
PLANS = ("ball_bar", "ball_bar_three_planes")


def trial(number: int, count: int, size: float) -> Outcome | None:
    """One machine; None where no such causes can be hidden in it."""
    outcome = Outcome("ball bar", number, PLANS[number % len(PLANS)])
    try:
        world = machining(outcome.plan, number, sizes=(size,) * count, names=CAUSES)
    except CalibrationError:
        return None
    outcome.hidden = " ".join(world.listed)
    judge(world, outcome)
    return outcome


def table(outcomes: Sequence[tuple[int, Outcome]]) -> str:
    """Shares by number of causes."""
    lines = [
        "| causes | machines | all named % | none wrong % | processor s of a diagnosis |",
        "|---:|---:|---:|---:|---:|",
    ]
    for count in sorted({count for count, _ in outcomes}):
        mine = [outcome for k, outcome in outcomes if k == count]
        named = 100.0 * np.mean([bool(o.named) for o in mine])
        right = 100.0 * np.mean([not o.wrong for o in mine])
        lines.append(
            f"| {count} | {len(mine)} | {named:.0f} | {right:.0f} | {np.median([o.seconds for o in mine]):.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--size", type=float, default=6.0, help="standard uncertainties (default: 6)")
    given = parser.parse_args()
    outcomes: list[tuple[int, Outcome]] = []
    for number in range(given.first_seed, given.first_seed + given.trials):
        count = 1 + number % 4
        outcome = trial(number, count, given.size)
        if outcome is None:
            continue
        outcomes.append((count, outcome))
        marks = "WRONG " * bool(outcome.wrong) + "MISSED" * (not outcome.named)
        print(number, outcome.plan, outcome.hidden, "->", outcome.accepted, marks, flush=True)
    print(table(outcomes))


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""Time of a Monte Carlo propagation (GUM Supplement 1) at the size of the probing paper's first case study.

92 points at four angles of C, the errors of all points: processor time of the draws, with their one factorisation, and
the largest difference of their standard uncertainties from the closed form, over what chance leaves.

    python benchmarks/probing_draws.py
"""

from __future__ import annotations

import time

import numpy as np
from papers.study_probing import fit_first_case

from machine_tool_calibration.methods.probing.features import monte_carlo
from machine_tool_calibration.methods.probing.model import ProbingModel, responses


def main() -> None:
    """Print times and differences."""
    fit = fit_first_case()
    model = fit.model
    assert isinstance(model, ProbingModel)
    n_points = len(model.description.workpiece)
    closed = np.sqrt(np.diag(responses(fit, model.touches.point, n_points).combine(np.eye(n_points))[1]))
    print(f"{n_points} points, {len(model.observations)} touches")
    print(f"{'touches':14}{'draws':>8}{'best of 5, ms':>15}{'largest difference, in chance':>32}")
    for distribution in ("normal", "rectangular", "triangular"):
        for draws in (1000, 10_000):
            times = []
            for seed in range(5):
                begin = time.process_time()
                found = monte_carlo(fit, np.eye(n_points), draws, distribution, seed)
                times.append(time.process_time() - begin)
            chance = closed / np.sqrt(2.0 * (draws - 1))
            off = float(np.max(np.abs(found.uncertainty - closed) / chance))
            print(f"{distribution:14}{draws:8}{1e3 * min(times):15.1f}{off:32.1f}")


if __name__ == "__main__":
    main()

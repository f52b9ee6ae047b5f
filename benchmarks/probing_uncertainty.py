# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the probing self-calibration beside the paper's figures (Section 6: Figs. 18 to 20, Table 2).

The paper does not print the points, so they are assumed (config/workpieces/cross_pocket.yaml). All figures are expanded
uncertainties (k = 2) for 1.38 um standard uncertainty of one touch, from the covariance; the paper's are from 1000
simulated runs. The length is taken as exact, as in Eq. (17). Agreement is not forced: what the assumed points give is
printed as it is.

    python benchmarks/probing_uncertainty.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machine_tool_calibration.methods.probing.forecast import forecast
from machine_tool_calibration.procedure.workpiece import read_workpiece, workpiece_entries
from machine_tool_calibration.session.description import Probing, WorkpiecePoint

PART = Path(__file__).parent.parent / "config" / "workpieces" / "cross_pocket.yaml"
ANGLES = (0, 75, 130, 210)
PAPER_WORKPIECE = {2: 6.5, 3: 3.0, 4: 2.1}
PAPER_C = {"EXC": (0.0, 1.0, 1.2, 1.2), "EYC": (0.0, 0.9, 1.1, 1.2), "ECC": (0.0, 8.9, 9.3, 8.2)}


def described(points: tuple[WorkpiecePoint, ...], angles: tuple[int, ...]) -> Probing:
    """The plan of case study 1 with some of its angles, degrees."""
    nodes = [round(0.022 * k, 3) for k in range(-5, 6)]
    return Probing.model_validate(
        {
            "format": "mtcal-session/1",
            "method": "probing",
            "machine": {"chain": "w-C-b-Y-X-Z-t", "rotation_sign": -1, "table_grid": {"x": nodes, "y": nodes}},
            "workpiece": workpiece_entries(points),
            "setups": [{"id": f"C{k + 1}", "c": float(np.radians(a))} for k, a in enumerate(angles)],
            "known": {"EXX": {"position": 0.11, "value": 0.0, "standard_uncertainty": 0.0}},
            "standard_uncertainty": {"displacement": 1.38e-6},
        }
    )


def expanded(points: tuple[WorkpiecePoint, ...], angles: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Expanded uncertainties (k = 2), micrometres and microradians."""
    content = forecast(described(points, angles)).error_map.content
    return {key[:-2]: 2e6 * np.asarray(value) for key, value in content.items() if key.endswith("_u")} | {
        "grid": content["grid"]
    }


def main() -> None:
    """Print ours beside the paper's."""
    points = read_workpiece(PART)
    bare = tuple(p for p in points if p.feature == "work")
    print("U (k = 2), um. Points assumed: arms of 100 mm, spheres at (80, 65) and (-75, -70) mm; 1.38 um per touch.\n")
    print(f"{'largest U of the workpiece error':34}{'paper':>8}{'form':>8}{'position and form':>20}")
    for count, paper in PAPER_WORKPIECE.items():
        ours = expanded(points, ANGLES[:count])
        form, position = np.nanmax(ours["workpiece_form"]), np.nanmax(ours["workpiece_error"])
        print(f"  with {count} angles, Fig. 18{'':12}{paper:8.1f}{form:8.1f}{position:20.1f}")
    without = expanded(bare, ANGLES)
    form, position = np.nanmax(without["workpiece_form"]), np.nanmax(without["workpiece_error"])
    print(f"  with 4 angles, no sphere, Fig. 19{'< 6.1':>9}{form:8.1f}{position:20.1f}")
    ours = expanded(points, ANGLES)
    error, y = ours["position_error"], np.abs(ours["grid"][:, 1])
    edge, inner = error[y > 0.109].max(), error[y < 0.109].max()
    print(f"\n{'U of the axes, Fig. 20':34}{'paper':>8}{'ours':>8}")
    print(f"  largest at Y = +-110 mm{'':11}{28:8.0f}{edge:8.1f}")
    print(f"  largest elsewhere{'':17}{'':8}{inner:8.1f}")
    print(f"  share of the grid below 10 um{'':5}{'large':>8}{np.mean(error.max(axis=1) < 10):8.0%}")
    print(f"\n{'U of C, Table 2':16}" + "".join(f"{f'{a} deg':>16}" for a in ANGLES))
    print(f"{'':16}" + "    paper   ours" * 4)
    for name, paper_row in PAPER_C.items():
        unit = "urad" if name == "ECC" else "um"
        row = "".join(f"{a:9.1f}{b:7.1f}" for a, b in zip(paper_row, ours[name], strict=True))
        print(f"  {name + ' ' + unit:14}{row}")


if __name__ == "__main__":
    main()

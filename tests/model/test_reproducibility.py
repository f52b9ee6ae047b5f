# SPDX-License-Identifier: Apache-2.0
"""What belongs together of what does not reproduce."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.reproducibility import reproducibility
from machine_tool_calibration.session.folder import read_session

HEAD = """format: mtcal-session/1
method: direct
machine: {chain: w-X-b-t, travel: {x: [0.0, 0.5]}}
repeats: 2
standard_uncertainty: {displacement: 1.0e-06}
datum: offset
terms: [EXX]
setups:
- {id: A}
"""


def test_the_way_back_to_the_beginning_of_the_next_repeat_is_no_pass(tmp_path: Path) -> None:
    places = np.linspace(0.0, 0.5, 6)
    there_and_back = [*places, *places[::-1]]
    rows = [(k, x) for k, run in enumerate((there_and_back, there_and_back[6:] + there_and_back[:6])) for x in run]
    lines = ["setup,repeat,x,gx,gy,gz,displacement"]
    lines += [f"A,{k},{x:.2f},1,0,0,{1e-6 * j:.9f}" for j, (k, x) in enumerate(rows)]
    (tmp_path / "session.yaml").write_text(HEAD, encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (family,) = reproducibility(build_model(read_session(tmp_path))[0].observations)
    assert family.name == "pass"
    assert family.group.tolist() == np.repeat(np.arange(4), 6).tolist()

# SPDX-License-Identifier: Apache-2.0
"""Small procedures for tests."""

from machine_tool_calibration.procedure import Plan, parse_procedure, plan

TEXT = """
format: mtcal-procedure/1
name: small
session:
  method: tracking_interferometer
  dimension: 2
  pointing: open_loop
  machine: {chain: w-C-b-Y-X-Z-t, travel: {x: [0.0, 0.4], y: [0.0, 0.4], z: [0.0, 0.05]}}
  repeats: 2
  setups:
  - {id: A, position: [-0.35, 0.05, 0.0]}
  - {id: B, position: [0.15, -0.40, 0.0]}
  standard_uncertainty: {displacement: 3.0e-7}
path:
  grid: {x: {first: 0.0, last: 0.4, count: 3}, y: [0.1, 0.2]}
motion: {dwell: 1.0}
"""


def small(text: str = TEXT) -> Plan:
    return plan(parse_procedure(text, "small.yaml"))

# SPDX-License-Identifier: Apache-2.0
"""A measurement procedure: targets, stations, repeats, order and waiting times, without ROS."""

from machine_tool_calibration.procedure.description import Procedure, parse_procedure, read_procedure
from machine_tool_calibration.procedure.steps import Plan, Step, plan

__all__ = ["Plan", "Procedure", "Step", "parse_procedure", "plan", "read_procedure"]

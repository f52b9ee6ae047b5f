# SPDX-License-Identifier: Apache-2.0
"""Drivers of real displacement instruments: what takes the simulated instrument's place."""

from machine_tool_calibration.instruments.drivers.driver import Driver, Health, InstrumentError, Sample
from machine_tool_calibration.instruments.drivers.load import load_driver

__all__ = ["Driver", "Health", "InstrumentError", "Sample", "load_driver"]

"""Calibration of machine tools: geometric errors from displacement readings."""

__version__ = "0.1.0"

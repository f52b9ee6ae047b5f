# SPDX-License-Identifier: Apache-2.0
"""A certificate that a laboratory signs: its pages, and the same as a Digital Calibration Certificate."""

# SPDX-License-Identifier: Apache-2.0
"""The cube of a tracking interferometer with three places along each axis, a quarter of those of the preset."""

from machine_tool_calibration.simulation import PRESETS

CUBE = PRESETS["tracking_3d"].model_copy(update=dict.fromkeys("xyz", (0.0, 0.2, 0.4)))

# SPDX-License-Identifier: Apache-2.0
"""Make the pictures and the page of this folder again: python docs/effects/make.py."""

from pathlib import Path

from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.plots.gallery import draw_gallery

SHOWN = (
    "backlash_y backlash_c lost_motion_y reversal_EYX thermal_expansion_x thermal_lag_x warmup_y screw_growth_x "
    "pitch_periodic_x reversal_periodic_x refractive_index dead_path linear_drift station_drift mirror_misalignment "
    "pointer_radial_error pointer_zero_offset pointer_axis_offset retroreflector_form table_thermal_growth "
    "rotary_axis_drift workpiece_thermal probe_pretravel scale ECX EBZ EXX C0Y "
    "squareness_drift_C0Y squareness_thermal_C0Y"
)

if __name__ == "__main__":
    draw_gallery(find_effects(SHOWN.split()), Path(__file__).parent)

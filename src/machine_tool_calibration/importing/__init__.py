# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs (coordinate measuring machines, laser trackers, interferometers) as sessions."""

from machine_tool_calibration.importing.build import Imported, import_table
from machine_tool_calibration.importing.mapping import Mapping, parse_mapping, read_mapping

__all__ = ["Imported", "Mapping", "import_table", "parse_mapping", "read_mapping"]

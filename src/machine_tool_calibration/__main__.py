# SPDX-License-Identifier: Apache-2.0
"""`python -m machine_tool_calibration` is the command `mtcal`."""

from machine_tool_calibration.cli.main import main

if __name__ == "__main__":
    main()

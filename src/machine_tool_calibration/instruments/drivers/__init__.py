# SPDX-License-Identifier: Apache-2.0
"""Drivers of real displacement instruments: what takes the simulated instrument's place."""

from importlib.metadata import entry_points
from pathlib import Path

from machine_tool_calibration.instruments.drivers.ascii_line import AsciiLineDriver
from machine_tool_calibration.instruments.drivers.driver import Driver, Health, InstrumentError, Sample
from machine_tool_calibration.instruments.drivers.settings import AsciiLineSettings
from machine_tool_calibration.session.record import validated
from machine_tool_calibration.session.text import read_yaml

__all__ = ["PLUGIN_GROUP", "Driver", "Health", "InstrumentError", "Sample", "load_driver"]

PLUGIN_GROUP = "machine_tool_calibration.drivers"
LARGEST_FILE = 1 << 20


def load_driver(file: Path) -> Driver:
    """The driver that a YAML file describes, not yet opened; a CalibrationError says what is wrong in it and where.

    The key `driver` names it: `ascii_line`, or a plugin of the entry-point group `machine_tool_calibration.drivers`, a
    callable that takes the file's content as a mapping and returns a `Driver`.
    """
    source = str(file)
    document = read_yaml(file, LARGEST_FILE)
    content = document.value
    if not isinstance(content, dict) or not isinstance(content.get("driver"), str):
        raise InstrumentError(f"{source}: the key 'driver' must name the driver, such as ascii_line")
    if content["driver"] == "ascii_line":
        settings = validated(AsciiLineSettings, content, source, document, refusal=InstrumentError)
        return AsciiLineDriver(settings)
    for entry in entry_points(group=PLUGIN_GROUP, name=content["driver"]):
        try:
            driver = entry.load()(content)
        except Exception as error:
            raise InstrumentError(f"{source}: the driver {entry.name!r} failed: {error}") from error
        if not isinstance(driver, Driver):
            raise InstrumentError(f"{source}: the plugin {entry.name!r} is no driver")
        return driver
    raise InstrumentError(f"{source}: there is no driver {content['driver']!r}; ascii_line is built in")

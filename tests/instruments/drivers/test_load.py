# SPDX-License-Identifier: Apache-2.0
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.instruments import drivers
from machine_tool_calibration.instruments.drivers import (
    PLUGIN_GROUP,
    Driver,
    Health,
    InstrumentError,
    Sample,
    load_driver,
)

EXAMPLES = sorted((Path(__file__).parents[3] / "config" / "drivers").glob("*.yaml"))
TEXT = r"""
format: mtcal-driver/1
driver: ascii_line
connection: {tcp: {host: localhost, port: 4001}}
line: {pattern: '(?P<value>\S+)', terminator: "\r\n"}
value: {unit: mm}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "driver.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_load(path: Path) -> None:
    driver = load_driver(path)
    assert isinstance(driver, Driver)
    assert driver.health().state == "disconnected"


def test_the_instrument_is_known_by_its_own_number_or_by_where_it_is_connected(tmp_path: Path) -> None:
    assert load_driver(write(tmp_path, TEXT)).hardware_id == "localhost:4001"
    assert load_driver(write(tmp_path, TEXT + "hardware_id: SN 12345\n")).hardware_id == "SN 12345"


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("unit: mm", "unit: furlong", "line 6: value.unit"),
        ("unit: mm", "unit: mm, scale: 0", "line 6: value.scale: must not be 0"),
        ("unit: mm", "unit: mm, scael: 1", "line 6: unknown key 'value.scael' (did you mean 'scale'?)"),
        ("value: {unit: mm}", "", "the key 'value' is missing"),
        (r"(?P<value>\S+)", r"(?P<value>\S+", "not a regular expression"),
        (r"(?P<value>\S+)", r"\S+", "no group"),
        (r"(?P<value>\S+)", r"(?P<value>\S+) (?P<beam>.)", "beam_ok"),
        (r"(?P<value>\S+)", r"(?P<value>\S+) (?P<signal>.)", "'signal'"),
        ("port: 4001", "port: 400100", "connection.tcp.port"),
        ("{tcp: {host: localhost, port: 4001}}", "{}", "either tcp or serial"),
        (r'"\r\n"', '"µ"', "only ASCII"),
        ("driver: ascii_line", "driver: telepathy", "no driver 'telepathy'"),
        ("driver: ascii_line", "", "the key 'driver'"),
        (TEXT, "", "the key 'driver'"),
    ],
)
def test_a_wrong_file_is_one_line_that_says_where(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = write(tmp_path, TEXT.replace(old, new))
    with pytest.raises(CalibrationError) as error:
        load_driver(path)
    message = str(error.value)
    assert says in message
    assert str(path) in message
    assert "\n" not in message


class Silent:
    """The least that is a driver."""

    def __init__(self, content: dict[str, object]) -> None:
        self.content = content

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> list[Sample]:
        return []

    def health(self) -> Health:
        return Health("silent")

    def close(self) -> None:
        pass


def plugin(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    def found(*, group: str, name: str) -> list[EntryPoint]:
        entry = EntryPoint("mine", value, PLUGIN_GROUP)
        return [entry] if (group, name) == (entry.group, entry.name) else []

    monkeypatch.setattr(drivers, "entry_points", found)


def test_a_plugin_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers, "Silent", Silent, raising=False)
    plugin(monkeypatch, f"{drivers.__name__}:Silent")
    driver = load_driver(write(tmp_path, "driver: mine\ncolour: red\n"))
    assert isinstance(driver, Silent)
    assert driver.content == {"driver": "mine", "colour": "red"}


@pytest.mark.parametrize("value", ["no_such_module:Driver", "json:nothing", "json:loads", "builtins:list"])
def test_a_broken_plugin_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    plugin(monkeypatch, value)
    with pytest.raises(InstrumentError, match="mine"):
        load_driver(write(tmp_path, "driver: mine\n"))

# SPDX-License-Identifier: Apache-2.0
"""What the YAML file of an instrument with an ASCII line protocol says."""

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from machine_tool_calibration.session.record import Finite, NotNegative, Positive, Record

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254}


def _ascii(text: str) -> str:
    if not text.isascii():
        raise ValueError("only ASCII characters can be sent")
    return text


Ascii = Annotated[str, Field(min_length=1), AfterValidator(_ascii)]


class Tcp(Record):
    """A TCP server, in the instrument or a serial device server."""

    host: str
    port: Annotated[int, Field(ge=1, le=65535)]

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class Serial(Record):
    """A serial port."""

    port: str
    baudrate: Annotated[int, Field(gt=0)] = 9600
    bytesize: Literal[5, 6, 7, 8] = 8
    parity: Literal["none", "even", "odd", "mark", "space"] = "none"
    stopbits: float = 1

    @field_validator("stopbits")
    @classmethod
    def _possible(cls, number: float) -> float:
        if number not in (1, 1.5, 2):
            raise ValueError("must be 1, 1.5 or 2")
        return number

    def __str__(self) -> str:
        return self.port


class Connection(Record):
    """Where the instrument is: one of the two."""

    tcp: Tcp | None = None
    serial: Serial | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.tcp is None) == (self.serial is None):
            raise ValueError("give either tcp or serial")
        return self

    def __str__(self) -> str:
        return str(self.tcp or self.serial)


class Line(Record):
    """One line of the instrument."""

    # regular expression that the whole line (without blanks around it) matches, with the group `value` and, where the
    # instrument sends them, `status` and `beam`
    pattern: str
    beam_broken: str | None = None  # expression of a line that says that the beam is broken and carries no value
    ignore: str | None = None  # expression of lines neither readings nor garbage: greetings, acknowledgements
    terminator: Annotated[Ascii, Field(max_length=4)] = "\n"  # what ends a line
    status_ok: tuple[str, ...] | None = None  # the words of `status` with which a value is valid; any word if not given
    beam_ok: tuple[str, ...] = ()  # the words of `beam` that mean an unbroken beam
    max_length: Annotated[int, Field(ge=8, le=65536)] = 256  # a longer line is garbage, bytes

    @field_validator("pattern", "beam_broken", "ignore")
    @classmethod
    def _compiles(cls, text: str | None) -> str | None:
        try:
            re.compile(text or "")
        except re.error as error:
            raise ValueError(f"not a regular expression: {error}") from None
        return text

    @model_validator(mode="after")
    def _check(self) -> Self:
        groups = set(re.compile(self.pattern).groupindex)
        if "value" not in groups:
            raise ValueError("the pattern has no group (?P<value>…)")
        if unknown := sorted(groups - {"value", "status", "beam"}):
            raise ValueError(f"the pattern has the group {unknown[0]!r}; value, status and beam are known")
        if ("beam" in groups) != bool(self.beam_ok):
            raise ValueError("the pattern's group beam and the list beam_ok belong together")
        if self.status_ok is not None and "status" not in groups:
            raise ValueError("status_ok needs the pattern's group status")
        return self


class Value(Record):
    """What the number means: displacement = value · scale · unit."""

    unit: Literal["m", "mm", "um", "nm", "in"]  # unit of the number
    scale: Finite = 1.0  # factor, such as 0.5 for a count of a folded path, -1 for the opposite sense

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0:
            raise ValueError("must not be 0")
        return scale


class Request(Record):
    """For an instrument that answers and does not stream."""

    text: Ascii  # what asks for one reading, with its terminator
    interval: NotNegative = 0.0  # least time from one request to the next, s


class Timeouts(Record):
    """Times, s."""

    connect: Positive = 5.0  # for a connection to be made
    answer: Positive = 1.0  # for the answer to a request
    silence: Positive = 2.0  # without a sample for this long, the instrument counts as silent
    reconnect: Positive = 1.0  # pause before a lost connection is tried again


class AsciiLineSettings(Record):
    """An instrument that sends readings as lines of ASCII text."""

    format: Literal["mtcal-driver/1"]
    driver: Literal["ascii_line"]
    connection: Connection
    line: Line
    value: Value
    request: Request | None = None
    start: Ascii | None = None  # text sent after connecting, such as a command to begin streaming
    timeouts: Timeouts = Timeouts()
    hardware_id: str = ""  # of the instrument in diagnostics, as its serial number; its connection if not given

# SPDX-License-Identifier: Apache-2.0
"""What a foreign table's columns mean: from a mapping file, the command line, or both."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from machine_tool_calibration.errors import SessionError, did_you_mean
from machine_tool_calibration.importing.text_table import FileForm
from machine_tool_calibration.session.record import Record, validated
from machine_tool_calibration.session.text import read_yaml
from machine_tool_calibration.units import UNITS, spelled

FORMAT = "mtcal-mapping/1"
_XYZ = ("x", "y", "z")

_COMMON = {
    **dict.fromkeys(("setup", "point"), "text"),
    **dict.fromkeys(_XYZ, "length"),
    **dict.fromkeys(("a", "b", "c"), "angle"),
    "time": "time",
    **dict.fromkeys(("repeat", *(f"dir_{axis}" for axis in "xyzabc"), "relative_humidity"), "number"),
    **{f"temperature_{place}": "temperature" for place in ("air", "x", "y", "z", "table", "work")},
    "air_pressure": "pressure",
}
_ANGLES = dict.fromkeys(("azimuth", "bearing", "elevation", "zenith"), "angle")
_ACTUAL = {f"actual_{axis}": "length" for axis in _XYZ}
ROLES: dict[str, dict[str, str]] = {
    "points": {**_COMMON, **_ACTUAL, **{f"deviation_{axis}": "length" for axis in _XYZ}, "range": "length", **_ANGLES},
    "ranges": {**_COMMON, "target": "text", "range": "length", **_ANGLES, **_ACTUAL},
    "iso230-2": {
        **_COMMON,
        **dict.fromkeys(("position", "actual", "deviation"), "length"),
        "run": "number",
        "direction": "text",
    },
    "circles": {**_COMMON, "angle": "angle", **dict.fromkeys(("radius", "deviation"), "length"), "way": "text"},
    "readings": {
        **_COMMON,
        "target": "text",
        **dict.fromkeys(("azimuth", "elevation"), "angle"),
        **dict.fromkeys(("gx", "gy", "gz"), "number"),
        "displacement": "length",
    },
}
"""For each kind of table what a column can be, and its dimension."""
_OPTIONS: dict[str, tuple[str, ...]] = {
    "points": ("origin", "sign", "align"),
    "ranges": ("origin", "stations", "targets"),
    "iso230-2": ("origin", "sign", "layout", "transposed", "runs", "axis", "actual", "senses"),
    "circles": ("sign",),
    "readings": (),
}


Text = Annotated[str, BeforeValidator(lambda value: str(value) if isinstance(value, int | float) else value)]


class ColumnRule(Record):
    """Where a quantity stands."""

    column: Text  # the name in the header; its number where there is no header
    # of its numbers; absent, the unit in brackets at the end of the name, or that of the dimension counts
    unit: Annotated[str, AfterValidator(spelled)] | None = None


class Run(Record):
    """One run of ISO 230-2 as a column."""

    column: Text  # its name; its number where there is no header
    direction: Literal["up", "down"]  # of approach


Column = Annotated[
    ColumnRule, BeforeValidator(lambda value: {"column": str(value)} if isinstance(value, str | int) else value)
]


class Mapping(Record):
    """How a foreign table becomes a session."""

    format: Literal["mtcal-mapping/1"] = "mtcal-mapping/1"
    # `points` (nominal and measured coordinates), `ranges` (distances from the stations of a tracker), `iso230-2`
    # (deviations at target positions in runs up and down), `circles` (a ball bar's radius over the angle) or `readings`
    # (those of any method)
    table: Literal["points", "ranges", "iso230-2", "circles", "readings"]
    file: FileForm = FileForm()  # how the text is written
    columns: dict[str, Column] = Field(default_factory=dict)  # where each quantity stands (`ROLES`)
    extras: dict[str, Column] = Field(default_factory=dict)  # covariates by the name that they get, with their column
    # of each dimension (length, angle, …) or quantity (x, deviation, …)
    units: dict[str, Annotated[Text, AfterValidator(spelled)]] = Field(default_factory=dict)
    # quantities that are the same in every row, such as `z: 120mm`
    values: dict[str, Text] = Field(default_factory=dict)
    # of nominal coordinates in the machine's, by axis, such as `x: 250mm`
    origin: dict[Literal["x", "y", "z"], Text] = Field(default_factory=dict)
    sign: Literal["actual-minus-nominal", "nominal-minus-actual"] = "actual-minus-nominal"  # of deviations in the file
    align: bool = False  # points: shift and turn each setup's measured points onto the nominal ones first
    layout: Literal["wide", "long"] = "wide"  # iso230-2: a column for each run, or a row for each reading
    transposed: bool = False  # iso230-2: a row for each run instead of a column
    # iso230-2: the columns of the runs in order; absent, every other column, by its name (`1 up`, `1 down`)
    runs: tuple[Run, ...] = ()
    axis: Literal["x", "y", "z"] | None = None  # iso230-2: that was moved
    actual: bool = False  # iso230-2: the columns of the runs hold actual positions instead of deviations
    senses: Literal["x", "y", "z"] | None = None  # iso230-2: direction that was read, if it is another (straightness)
    # position of a tracker's stations, machine frame, such as `A: -350, 50, 0 mm`
    stations: dict[str, str] = Field(default_factory=dict)
    targets: dict[str, str] = Field(default_factory=dict)  # position of targets on a rotary table, table frame at c = 0
    # keys of session.yaml: machine, datum, terms, standard_uncertainty, …
    session: dict[str, Any] = Field(default_factory=dict)

    @property
    def trusted(self) -> bool:
        """Whether what looks like another unit or another frame is taken as it is."""
        return self.session.get("trust_units") is True


def read_mapping(path: Path) -> dict[str, Any]:
    """The content of a mapping file, for `parse_mapping`; a SessionError if it is no mapping of keys."""
    document = read_yaml(path, 1 << 20)
    if not isinstance(document.value, dict):
        raise SessionError(f"{path}: must be a mapping of keys")
    if document.value.get("format") != FORMAT:
        raise SessionError(f"{path}: format is {document.value.get('format')!r}, not {FORMAT}")
    return document.value


def parse_mapping(content: dict[str, Any], source: str) -> Mapping:
    """The mapping from the keys of the file, the command line, or both; a SessionError names the key that is wrong."""
    mapping = validated(Mapping, content, source, unnamed=("[key]",))
    roles, plain = ROLES[mapping.table], Mapping(table=mapping.table)
    for key in dict.fromkeys(key for keys in _OPTIONS.values() for key in keys):
        if key not in _OPTIONS[mapping.table] and getattr(mapping, key) != getattr(plain, key):
            raise SessionError(f"{source}: a table of {mapping.table} has no {key}")
    for kind in ("columns", "values"):
        for role in getattr(mapping, kind):
            if role not in roles:
                raise SessionError(
                    f"{source}: {kind} names {role!r}, which a table of {mapping.table} does not have"
                    f"{did_you_mean(role, roles)}; a covariate of your own goes under extras"
                )
            if role in mapping.columns and role in mapping.values:
                raise SessionError(f"{source}: {role} is both a column and a value")
    dimensions = {unit[0] for unit in UNITS.values()}
    for name in mapping.units:
        if name not in roles and name not in dimensions and name not in mapping.extras:
            hint = did_you_mean(name, (*roles, *dimensions))
            raise SessionError(f"{source}: units names {name!r}, which is neither a quantity nor a dimension{hint}")
    return mapping

# SPDX-License-Identifier: Apache-2.0
"""The text of `session.yaml` to a description and back, and lists of which points make a feature."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import METHODS, method_names, method_spec
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.record import AnyRecord, Record, either, kind_of, place_in, shown, validated
from machine_tool_calibration.session.text import Document, load_yaml, read_text, yaml_text
from machine_tool_calibration.session.values import Identifier


def parse_description(text: str, source: str) -> Description:
    """The description that a `session.yaml` holds; a SessionError: its `source`, line and key of the first defect."""
    document = _mapping(text, source, Description)
    return describe(document.value, source, document)


def parse_record(text: str, source: str, record: type[AnyRecord]) -> AnyRecord:
    """A record of another kind that a YAML text holds, with its `format`; errors as for `parse_description`."""
    document = _mapping(text, source, record)
    return validated(record, document.value, source, document)


def _mapping(text: str, source: str, record: type[BaseModel]) -> Document:
    # no key takes a truth value, and pydantic would take one for a number
    document = load_yaml(text, source, truth=False)
    if document.value is None:
        raise SessionError(f"{source}: the file is empty")
    if not isinstance(document.value, dict):
        raise SessionError(f"{source}: must be a mapping of keys, not {kind_of(document.value)}")
    _check_key("format", get_args(record.model_fields["format"].annotation), source, document)
    return document


def describe(value: Any, source: str, document: Document | None = None) -> Description:
    """The description from a mapping of keys; errors as for `parse_description`."""
    document = document or Document(value, {})
    # Installed packages are searched for methods only where the name is none of ours.
    ours = tuple(METHODS)
    _check_key("method", ours if value.get("method") in ours else method_names(), source, document)
    return validated(method_spec(value["method"]).description, value, source, document)


def _check_key(key: str, allowed: Sequence[str], source: str, document: Document) -> None:
    if key not in document.value:
        raise SessionError(f"{source}: the key {key!r} is missing")
    value = document.value[key]
    if value not in allowed:
        where = place_in(source, document, (key,))
        raise SessionError(f"{where}: {key} is {shown(value)}, not {either(allowed)}")


def description_yaml(description: Description) -> str:
    """The text of `session.yaml`; numbers are written so that they come back to the last bit."""
    content = description.model_dump(mode="python", exclude_none=True)
    content = {"format": content.pop("format"), "method": content.pop("method"), **content}
    plain = {key: value for key, value in content.items() if value != {} and value != () and value is not False}
    # What is 0 and said of no setup need not be said.
    plain["standard_uncertainty"] = description.standard_uncertainty.model_dump(exclude_defaults=True)
    plain["machine"] = {key: value for key, value in plain["machine"].items() if value != {}}
    return yaml_text(plain)


class _FeaturePoints(Record):
    """`features: {pin1: [0, 1, 2, 3], wall: [p7, p8, p9]}`: by feature, the ids of its points."""

    format: Literal["mtcal-feature-points/1"]
    features: Annotated[dict[str, Annotated[tuple[Identifier, ...], Field(min_length=1)]], Field(min_length=1)]


def read_feature_points(file: Path) -> dict[str, tuple[str, ...]]:
    """Ids of the points of each feature, where the session's points do not name it; errors as for a description."""
    return parse_record(read_text(file), str(file), _FeaturePoints).features

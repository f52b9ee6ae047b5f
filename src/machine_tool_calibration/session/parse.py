# SPDX-License-Identifier: Apache-2.0
"""The text of `session.yaml` to a description and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from machine_tool_calibration.errors import SessionError, did_you_mean
from machine_tool_calibration.session.catalogue import METHODS, method_names, method_spec
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.yaml_text import Document, load_yaml

__all__ = ["describe", "description_yaml", "parse_description", "parse_record"]

FORMAT = "mtcal-session/1"
AnyRecord = TypeVar("AnyRecord", bound=BaseModel)


def parse_description(text: str, source: str) -> Description:
    """The description that a `session.yaml` holds.

    Args:
        text: the file's content.
        source: the file's name, for messages.

    Raises:
        SessionError: one line with file, line and key of the first defect.
    """
    document = _mapping(text, source, FORMAT)
    return describe(document.value, source, document)


def parse_record(text: str, source: str, record: type[AnyRecord], form: str) -> AnyRecord:
    """A record of another kind that a YAML text holds.

    Args:
        text: the file's content.
        source: the file's name, for messages.
        record: what it holds.
        form: what its key `format` says.

    Raises:
        SessionError: one line with file, line and key of the first defect.
    """
    document = _mapping(text, source, form)
    try:
        return record.model_validate(document.value)
    except ValidationError as error:
        raise SessionError(_first_defect(error, source, document, record)) from None


def _mapping(text: str, source: str, form: str) -> Document:
    # no key takes a truth value, and pydantic would take one for a number
    document = load_yaml(text, source, truth=False)
    if document.value is None:
        raise SessionError(f"{source}: the file is empty")
    if not isinstance(document.value, dict):
        raise SessionError(f"{source}: must be a mapping of keys, not {_kind(document.value)}")
    _check_key("format", [form], source, document)
    return document


def describe(value: Any, source: str, document: Document | None = None) -> Description:
    """The description from a mapping of keys; errors as for `parse_description`."""
    document = document or Document(value, {})
    # Installed packages are searched for methods only where the name is none of ours.
    ours = tuple(METHODS)
    _check_key("method", ours if value.get("method") in ours else method_names(), source, document)
    record = method_spec(value["method"]).description
    try:
        return record.model_validate(value)
    except ValidationError as error:
        raise SessionError(_first_defect(error, source, document, record)) from None


def _check_key(key: str, allowed: Sequence[str], source: str, document: Document) -> None:
    if key not in document.value:
        raise SessionError(f"{source}: the key {key!r} is missing")
    value = document.value[key]
    if value not in allowed:
        where = _where(source, document, (key,))
        raise SessionError(f"{where}: {key} is {_shown(value)}, not {_either(allowed)}")


def description_yaml(description: Description) -> str:
    """The text of `session.yaml`; numbers are written so that they come back to the last bit."""
    content = description.model_dump(mode="python", exclude_none=True)
    content = {"format": content.pop("format"), "method": content.pop("method"), **content}
    plain = {key: _plain(value) for key, value in content.items() if value != {} and value != () and value is not False}
    # What is 0 and said of no setup needs not be said.
    declared = description.standard_uncertainty.model_dump(exclude_defaults=True)
    plain["standard_uncertainty"] = {key: _plain(value) for key, value in declared.items()}
    plain["machine"] = {key: value for key, value in plain["machine"].items() if value != {}}
    return yaml.dump(plain, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value


def _first_defect(error: ValidationError, source: str, document: Document, record: type[BaseModel]) -> str:
    # an unknown key is often the misspelt one that is then missing: it is the better message
    order = ("extra_forbidden", "missing")
    defects = error.errors(include_url=False)
    defects.sort(key=lambda d: order.index(d["type"]) if d["type"] in order else len(order))
    return _message(dict(defects[0]), source, document, record)


def _message(defect: dict[str, Any], source: str, document: Document, record: type[BaseModel]) -> str:
    path = tuple(defect["loc"])
    where, key = _where(source, document, path), _key(path)
    kind, context, value = defect["type"], defect.get("ctx", {}), defect["input"]
    if kind == "extra_forbidden":
        return f"{where}: unknown key {key!r}{_meant(defect['loc'], record)}"
    if kind == "missing" and path and isinstance(path[-1], int):
        return f"{where}: {_key(path[:-1])} is too short: its entry [{path[-1]}] is missing"
    if kind == "missing":
        return f"{where}: the key {key!r} is missing"
    if kind == "literal_error":
        return f"{where}: {key} is {_shown(value)}, not {context['expected']}"
    if kind in ("too_short", "too_long"):
        bound = f"at least {context['min_length']}" if "min_length" in context else str(context["max_length"])
        return f"{where}: {key} has {context['actual_length']} entries, not {bound}"
    if kind in ("finite_number", "float_parsing", "float_type"):
        return f"{where}: {key} must be a finite number, not {_shown(value)}"
    if kind in ("int_parsing", "int_type", "int_from_float", "int_parsing_size"):
        return f"{where}: {key} must be a whole number, not {_shown(value)}"
    if kind in ("tuple_type", "list_type"):
        return f"{where}: {key} must be a list, not {_kind(value)}"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return f"{where}: {key} must be a mapping of keys, not {_kind(value)}"
    if kind == "string_type":
        return f"{where}: {key} must be text, not {_shown(value)}"
    if kind == "greater_than":
        return f"{where}: {key} must be greater than {context['gt']:g}, not {_shown(value)}"
    if kind == "greater_than_equal":
        return f"{where}: {key} must be at least {context['ge']:g}, not {_shown(value)}"
    if kind == "value_error":
        text = str(context["error"])
        return f"{where}: {key}: {text}" if key else f"{where}: {text}"
    return f"{where}: {key}: {defect['msg']}"


def _where(source: str, document: Document, path: tuple[Any, ...]) -> str:
    line = document.line(path) if path else None
    return source if line is None else f"{source} line {line}"


def _key(path: tuple[Any, ...]) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _meant(location: tuple[Any, ...], whole: type[BaseModel]) -> str:
    """A suggestion for a misspelt key: the nearest that the record at that place has."""
    record: Any = whole
    for part in location[:-1]:
        if isinstance(part, int) or record is None:
            continue
        field = getattr(record, "model_fields", {}).get(part)
        record = _record_in(field.annotation) if field is not None else None
    names = list(getattr(record, "model_fields", {}))
    return did_you_mean(str(location[-1]), names)


def _record_in(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    for inner in get_args(annotation):
        found = _record_in(inner)
        if found is not None:
            return found
    return None


def _kind(value: Any) -> str:
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    return "text" if isinstance(value, str) else _shown(value)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict | list):
        return _kind(value)
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _either(values: Sequence[str]) -> str:
    return values[0] if len(values) == 1 else ", ".join(values[:-1]) + f" or {values[-1]}"

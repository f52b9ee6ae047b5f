# SPDX-License-Identifier: Apache-2.0
"""What records of all files have in common, plain numbers, and a record's first defect in one line."""

from collections.abc import Container, Sequence
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine_tool_calibration.errors import CalibrationError, SessionError, did_you_mean
from machine_tool_calibration.session.text import Document

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Record(BaseModel):
    """A frozen record that accepts no unknown key; its checks are made when one is first read, as that takes long."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


AnyRecord = TypeVar("AnyRecord", bound=BaseModel)

# Kinds of defects of a number that is too small or too large: where pydantic has the bound, and what it is.
_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}


def validated(
    record: type[AnyRecord],
    content: Any,
    source: str,
    document: Document | None = None,
    *,
    unnamed: Container[object] = (),
    refusal: type[CalibrationError] = SessionError,
) -> AnyRecord:
    """The record that a content is, else a `refusal` that says its first defect in one line.

    An unknown key first, as it is often the misspelt one that is then missing. `source` names what was read, the
    `document` its lines, if there is one. `unnamed` are parts of a defect's place that are no keys but pydantic's, such
    as names of variants.
    """
    try:
        return record.model_validate(content)
    except ValidationError as error:
        defects = error.errors(include_url=False)
    order = ("extra_forbidden", "missing")
    defects.sort(key=lambda d: order.index(d["type"]) if d["type"] in order else len(order))
    defect: dict[str, Any] = dict(defects[0])
    path, end = defect["loc"], len(defect["loc"]) - (defect["type"] in order)  # those end in a key
    named = (part for part in path[:end] if part not in unnamed and not str(part).startswith("function-"))
    defect["loc"] = (*named, *path[end:])
    place = place_in(source, document or Document(None, {}), defect["loc"])
    raise refusal(f"{place}: {_words(defect, record)}" if place else _words(defect, record))


def _words(defect: dict[str, Any], record: type[BaseModel]) -> str:
    path = tuple(defect["loc"])
    key, kind, context, value = _key(path) or "the content", defect["type"], defect.get("ctx", {}), defect["input"]
    if kind == "extra_forbidden":
        return f"unknown key {key!r}{_meant(defect['loc'], record)}"
    if kind == "missing" and path and isinstance(path[-1], int):
        return f"{_key(path[:-1])} is too short: its entry [{path[-1]}] is missing"
    if kind == "missing":
        return f"the key {key!r} is missing"
    if kind.startswith("union_tag"):
        tag = f"{key}.{context['discriminator'][1:-1]}"
        expected = context.get("expected_tags")
        return f"{tag} is {shown(context['tag'])}, not {expected}" if expected else f"the key {tag!r} is missing"
    if kind == "literal_error":
        return f"{key} is {shown(value)}, not {context['expected']}"
    if kind in ("too_short", "too_long"):
        bound = f"not at least {context['min_length']}" if kind == "too_short" else f"more than {context['max_length']}"
        return f"{key} has {len(value)} entries, {bound}"
    if kind in ("finite_number", "float_parsing", "float_type"):
        return f"{key} must be a finite number, not {shown(value)}"
    if kind in ("int_parsing", "int_type", "int_from_float", "int_parsing_size"):
        return f"{key} must be a whole number, not {shown(value)}"
    if kind in ("tuple_type", "list_type"):
        return f"{key} must be a list, not {kind_of(value)}"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return f"{key} must be a mapping of keys, not {kind_of(value)}"
    if kind.startswith("date"):
        return f"{key} must be a date, such as 2026-05-04, not {shown(value)}"
    if kind == "string_type":
        return f"{key} must be text, not {shown(value)}"
    if kind in _BOUNDS:
        bound, words = _BOUNDS[kind]
        return f"{key} must be {words} {context[bound]:g}, not {shown(value)}"
    text = str(context["error"]) if kind == "value_error" else f"{defect['msg'][:1].lower()}{defect['msg'][1:]}"
    return f"{key}: {text}" if path else text


def place_in(source: str, document: Document, path: tuple[Any, ...]) -> str:
    """File and line of a key, as far as they are known."""
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
        field = getattr(record, "model_fields", {}).get(part)
        if field is not None:  # else a place in a list, or a name of the user's own
            record = _record_in(field.annotation)
    return did_you_mean(str(location[-1]), list(getattr(record, "model_fields", {})))


def _record_in(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    for inner in get_args(annotation):
        if (found := _record_in(inner)) is not None:
            return found
    return None


def kind_of(value: Any) -> str:
    """What a value is, for people."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    return "text" if isinstance(value, str) else shown(value)


def shown(value: Any) -> str:
    """A value, for people, in one line of bounded length."""
    if value is None:
        return "nothing"
    if isinstance(value, dict | list):
        return kind_of(value)
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def either(values: Sequence[str]) -> str:
    """Alternatives in words."""
    return values[0] if len(values) == 1 else ", ".join(values[:-1]) + f" or {values[-1]}"

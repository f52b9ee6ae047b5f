# SPDX-License-Identifier: Apache-2.0
"""What a certificate states beside the result: the laboratory, its customer, the item, conditions, who signs."""

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints

from machine_tool_calibration.budget.conformity import RULES
from machine_tool_calibration.errors import SessionError, did_you_mean
from machine_tool_calibration.session.parse import parse_record
from machine_tool_calibration.session.record import Record, validated
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.text import read_text

# What else the keys of an item or an instrument are called under `about` in a session.
_SYNONYMS = {"serial_number": "serial", "type": "model"}

Text = Annotated[str, StringConstraints(strip_whitespace=True, max_length=4000)]
"""A text; empty where nothing is stated, as in a laboratory's file that waits to be filled in."""
Day = Annotated[date | None, BeforeValidator(lambda value: value or None)]


def _days(value: Any) -> Any:
    """One day or several, of which the first and the last count."""
    return ([value] if value else []) if isinstance(value, str | date) else value


def _told(entries: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(one for one in entries if getattr(one, "name", one))


def _known_rule(value: str) -> str:
    if value not in RULES:
        raise ValueError(f"no decision rule {value!r}{did_you_mean(value, RULES)}; there are {', '.join(RULES)}")
    return value


class Party(Record):
    """Who can be written to."""

    name: Text = ""
    street: Text = ""
    post_code: Text = ""
    city: Text = ""
    country: Annotated[Text, Field(pattern="^([A-Z]{2})?$")] = ""  # ISO 3166-1, as a DCC asks for
    email: Text = ""
    phone: Text = ""

    @property
    def lines(self) -> list[str]:
        """The address and how else to reach it, line by line."""
        city = " ".join(text for text in (self.post_code, self.city) if text)
        town = ", ".join(text for text in (city, self.country) if text)
        return [text for text in (self.street, town, self.email, self.phone) if text]


class Laboratory(Party):
    """Who calibrates."""

    accreditation: Text = ""  # by whom, for what
    code: Text = ""  # number of the accreditation
    logo: Text = ""  # file: SVG, PNG or JPEG


class Item(Record):
    """What was calibrated, or an instrument that it was calibrated with."""

    name: Text = ""
    manufacturer: Text = ""
    model: Text = ""
    serial: Text = ""

    @property
    def title(self) -> str:
        """Name, manufacturer and model in a line."""
        return ", ".join(text for text in (self.name, " ".join((self.manufacturer, self.model)).strip()) if text)


class Machine(Item):
    """What was calibrated."""

    inventory: Text = ""
    condition: Text = ""


class Instrument(Item):
    """What it was calibrated with."""

    certificate: Text = ""  # number of its certificate
    calibrated: Text = ""  # when
    calibrated_by: Text = ""  # which laboratory or institute


class Conditions(Record):
    """Under what it was measured, beside what was recorded with the readings."""

    temperature: Text = ""  # where none was recorded
    reference_temperature: Text = ""  # for which lengths are stated
    compensation: Text = ""  # of the controller: on or off, and which
    remarks: Text = ""


class DecisionRule(Record):
    """How it is decided whether a tolerance is kept."""

    rule: Annotated[str, AfterValidator(_known_rule)] = "guarded"
    probability: Annotated[float, Field(gt=0.5, lt=1.0)] = 0.95
    agreed: Text = ""  # with whom, when, where


class Signature(Record):
    """Who authorises the certificate."""

    name: Text = ""
    role: Text = ""


class Certificate(Record):
    """All that a laboratory states; what it leaves out is empty."""

    laboratory: Laboratory = Laboratory()
    customer: Party = Party()
    number: Text = ""
    order: Text = ""
    machine: Machine = Machine()
    location: Literal["", "laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = ""
    place: Text = ""
    received: Day = None
    measured: Annotated[tuple[date, ...], BeforeValidator(_days), AfterValidator(lambda days: tuple(sorted(days)))] = ()
    issued: Day = None
    procedure: Annotated[tuple[Text, ...], AfterValidator(_told)] = ()
    deviations: Text = ""
    adjustment: Text = ""
    conditions: Conditions = Conditions()
    instruments: tuple[Instrument, ...] = ()
    traceability: Text = ""
    specification: Text = ""
    decision_rule: DecisionRule = DecisionRule()
    from_customer: Text = ""
    external: Text = ""
    statement: Text = ""
    remarks: Text = ""
    signatures: Annotated[tuple[Signature, ...], AfterValidator(_told)] = ()
    raw_data: Literal["hash", "annex"] = "hash"
    template: Text = ""  # file that extends certificate.html


class _File(Record):
    """What a file holds; a laboratory has one of its own, and one for each order."""

    format: Literal["mtcal-certificate/1"]
    certificate: Certificate


def read_certificate(files: Sequence[Path], sessions: Sequence[Session]) -> Certificate:
    """What files state, a later one before an earlier one, and for the rest what `about` says in the sessions.

    A SessionError if a file cannot be read, or something in it is wrong; one line that says what and where.
    """
    declared = _of_sessions([session.description.about for session in sessions])
    for file in files:
        own = parse_record(read_text(file), str(file), _File).certificate
        content = own.model_dump(exclude_unset=True)
        if own.laboratory.logo:
            content["laboratory"]["logo"] = str(file.parent / own.laboratory.logo)
        if own.template:
            content["template"] = str(file.parent / own.template)
        declared = _merged(declared, content)
    where = " + ".join(map(str, files))
    found = validated(Certificate, declared, where)
    if found.issued is not None and found.measured and found.issued < found.measured[-1]:
        raise SessionError(f"{where}: issued on {found.issued}, before it was measured on {found.measured[-1]}")
    return found


def _merged(first: Mapping[str, Any], then: Mapping[str, Any]) -> dict[str, Any]:
    """What is stated in either, key by key; the second counts where both say something."""
    out = dict(first)
    for key, value in then.items():
        before = out.get(key)
        out[key] = _merged(before, value) if isinstance(before, Mapping) and isinstance(value, Mapping) else value
    return out


def _of_sessions(abouts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What descriptive data say under the names that they have by custom (docs/sessions.md)."""
    first = abouts[0] if abouts else {}
    instruments = [one for about in abouts for one in (about.get("instruments") or [about.get("instrument")]) if one]
    known = [_picked(one, Instrument) for one in instruments if isinstance(one, Mapping | str)]
    days = sorted(day for about in abouts if (day := _iso(about.get("date"))) is not None)
    return {
        "machine": _picked(first.get("machine"), Machine),
        "customer": _picked(first.get("customer"), Party),
        "instruments": [one for k, one in enumerate(known) if one not in known[:k]],
        "measured": days,
        **{key: first[key] for key in ("order", "place") if isinstance(first.get(key), str)},
    }


def _picked(value: Any, record: type[Record]) -> dict[str, str]:
    """A name, or those entries of a mapping that a record has."""
    if isinstance(value, str):
        return {"name": value}
    entries = value.items() if isinstance(value, Mapping) else ()
    named = {_SYNONYMS.get(key, key): text for key, text in entries if isinstance(text, str)}
    return {key: text for key, text in named.items() if key in record.model_fields}


def _iso(value: Any) -> date | None:
    try:
        return date.fromisoformat(str(value)[:10])
    except ValueError:
        return None

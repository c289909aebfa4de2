"""Errors of a configuration, in terms of its keys and without pydantic's own terms."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, get_args

from pydantic import ValidationError

from schemas.config import MOVED, REMOVED, Config
from schemas.config.section import Section
from schemas.errors import ConfigError

__all__ = ["config_error", "nearest"]

_KEY_OF_MAPPING: Final = "[key]"
"""Suffix that pydantic adds to the key of a mapping that it refuses."""

_EXPECTED: Final = {
    "bool": "true or false is expected",
    "date": "a date is expected",
    "dict": "a section with keys is expected",
    "float": "a number is expected",
    "int": "a whole number is expected",
    "model": "a section with keys is expected",
    "path": "a path is expected",
    "string": "text is expected",
    "tuple": "a list is expected",
}
"""What was expected, by the prefix of pydantic's error types (``int_parsing``, ``int_from_float``, ``int_type``)."""

_BOUNDS: Final = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}


def config_error(error: ValidationError, path: Path | str, model: type[Section] = Config) -> ConfigError:
    """Return one error that names every wrong key, the value that it must have, and the value that it has.

    path : the file that holds the keys, or the option of the command that sets them; model : what the keys are of
    """
    faults = _faults(error, model)
    if len(faults) == 1:
        place, what, remedy = faults[0]
        return ConfigError(what, where=path, place=place, remedy=remedy)
    told = "; ".join(f"{place}: {what}" if place else what for place, what, _ in faults)
    remedies = dict.fromkeys(f"{place}: {remedy}" if place else remedy for place, _, remedy in faults if remedy)
    return ConfigError(f"{len(faults)} keys are wrong: {told}", where=path, remedy=" ".join(remedies))


def nearest(word: object, known: Iterable[str]) -> str:
    """Return the question "did you mean …?" with the known word that is most similar to ``word``; empty if none is
    similar.
    """
    spelled = {name.casefold(): name for name in known}
    found = difflib.get_close_matches(str(word).casefold(), spelled, n=1, cutoff=0.8)
    return f"did you mean {spelled[found[0]]}?" if found else ""


def _faults(error: ValidationError, model: type[Section]) -> list[tuple[str, str, str]]:
    """Return (key, what is wrong, remedy) for each faulty key, in the order in which pydantic reports them."""
    found: dict[str, tuple[str, str, str]] = {}
    faults = error.errors()
    for fault in faults:
        if fault["type"] == "too_short" and _is_echo(fault, faults):
            continue
        location = _location(fault)
        place = ".".join(map(str, location))
        found.setdefault(place, (place, *_said(fault, location, model)))
    return [*found.values()]


def _is_echo(fault: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> bool:
    """Whether `fault`, the fault of a whole list or section, only follows from faults of single entries or keys in this
    list or section, as when a list is too short because its entries are wrong. Those faults are reported on their own.
    """
    own = fault["loc"]
    return any(other["loc"][: len(own)] == own for other in faults if len(other["loc"]) > len(own))


def _location(fault: Mapping[str, Any]) -> tuple[str | int, ...]:
    """Return the path of the faulty key as it is in the file. The location that pydantic gives has more parts: the
    alternative of a union type, and a mark on keys of mappings.
    """
    loc: tuple[str | int, ...] = fault["loc"]
    if loc and loc[0] == "store":
        return loc[:1]
    if fault["type"] == "missing" and isinstance(loc[-1], int):
        return loc[:-1]  # the list lacks it
    return tuple(part for part in loc if part != _KEY_OF_MAPPING)


def _said(fault: Mapping[str, Any], location: tuple[str | int, ...], model: type[Section]) -> tuple[str, str]:
    """Return what is wrong with a key, and what to do."""
    kind, given, context = fault["type"], fault.get("input"), fault.get("ctx", {})
    got = f"got {_shown(given)}"
    if kind == "extra_forbidden":
        key = ".".join(map(str, location))
        if model is Config and key in REMOVED:
            return f"the key is gone: {REMOVED[key]}", "Remove it."
        moved = MOVED.get(key) if model is Config else None
        if moved is not None:
            return f"the key is called {moved} now", f"Move it to {moved}."
        allowed = _allowed(location[:-1], model)
        return _unknown(location[-1], allowed)
    if kind == "literal_error" and fault["loc"][-1] == _KEY_OF_MAPPING:
        return _unknown(given, _choices(context["expected"]))
    if kind == "literal_error":
        choices = _choices(context["expected"])
        return f"{_shown(given)} is not allowed", _advice(given, choices, "Allowed are")
    if kind == "value_error":
        return str(context["error"]), ""
    if kind in ("missing", "too_short", "too_long"):
        return _wrong_length(fault)
    if location == ("store",):
        return f"a folder or an s3:// address is expected, {got}", ""
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"{words} {context[name]:g}, {got}", ""
    if kind == "finite_number":
        return f"a finite number is expected, {got}", ""
    if kind == "string_pattern_mismatch":
        return f"{_shown(given)} has a character that is not allowed", (
            "Use letters, digits, '.', '_' and '-', and begin with a letter or a digit."
        )
    if kind == "string_too_long":
        return f"at most {context['max_length']} characters are allowed, got {len(given or '')}", ""
    expected = _EXPECTED.get(kind.split("_")[0])
    return (f"{expected}, {got}", _remedy(kind, given, location, model)) if expected else (f"{fault['msg']}, {got}", "")


def _unknown(name: object, allowed: Sequence[str]) -> tuple[str, str]:
    return f"the key {_shown(name)} is unknown", _advice(name, allowed, "Allowed here:")


def _advice(name: object, allowed: Sequence[str], words: str) -> str:
    guess = nearest(name, allowed)
    listed = f"{words} {', '.join(allowed)}." if allowed else ""
    return " ".join(part for part in (guess[:1].upper() + guess[1:], listed) if part)


def _wrong_length(fault: Mapping[str, Any]) -> tuple[str, str]:
    given, context = fault.get("input"), fault.get("ctx", {})
    if fault["type"] == "too_long":
        return f"a list of {context['max_length']} is expected, got {_shown(given)}", ""
    if fault["type"] == "too_short":
        return "the list is empty", f"Give at least {context['min_length']}."
    if isinstance(fault["loc"][-1], int):
        return f"the list is too short, got {_shown(given)}", ""
    return "the key is missing", ""


def _remedy(kind: str, given: Any, location: Sequence[str | int], model: type[Section]) -> str:
    if given is None:
        required = len(location) == 1 and model.model_fields[str(location[0])].is_required()
        return "Give it a value." if required else "Give it a value, or remove the key to take its default."
    if kind == "tuple_type" and isinstance(given, str):
        return f"Write [{given}]."
    if kind == "tuple_type" and isinstance(given, dict):
        return "Begin each entry with a dash."
    if kind == "string_type" and isinstance(given, int | float):
        return f'Write "{given}", with quotes.'
    if location[:1] == ("sources",) and len(location) == 2:
        return "An entry has at least the keys family and root."
    return ""


def _choices(expected: str) -> list[str]:
    """Return the allowed values, which pydantic lists in one text such as ``'a', 'b' or 'c'``."""
    return expected.replace("'", "").replace(" or ", ", ").split(", ")


def _allowed(location: Sequence[str | int], model: type[Section]) -> list[str]:
    """Return the keys of the section at a location."""
    section: Any = model
    for part in location:
        if isinstance(part, str):
            section = _section(section.model_fields[part].annotation)
    return [*section.model_fields] if section is not None else []


def _section(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    return next((found for inner in get_args(annotation) if (found := _section(inner)) is not None), None)


def _shown(value: Any) -> str:
    """Format the beginning of a value. With YAML anchors and aliases, even a short file may hold an endless value."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxstring, brief.maxother = 2, 60, 60
    return brief.repr(value)[:60]

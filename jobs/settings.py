"""Settings that a person wrote, in YAML files or as KEY=VALUE. Every fault is one error that names file, place and
remedy, without pydantic's own terms.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import yaml
from pydantic import ValidationError

from schemas.base import Section
from schemas.config import Config
from schemas.errors import ConfigError

__all__ = ["NOT_YAML", "config_error", "export_folder", "nearest", "put", "read_section", "read_yaml", "yaml_value"]

NOT_YAML: Final = (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, RecursionError)
"""What a text that is not YAML raises; the last ones are values that their type can't have: a date of month 13, a
number of 5,000 digits, ``!!bool maybe``.
"""


class _UniqueKeyLoader(yaml.SafeLoader):
    """SafeLoader that refuses a key that occurs twice; YAML would use the later one without notice."""


def _mapping(loader: _UniqueKeyLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    keys: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        key, place = loader.construct_object(key_node, deep=True), f"line {key_node.start_mark.line + 1}"
        if not isinstance(key, Hashable):
            raise ConfigError("a list or a mapping is used as a key", place=place, remedy="Write name: value.")
        if key in keys:
            raise ConfigError(f"the key {key!r:.60} occurs twice", place=place, remedy="Keep one of them.")
        keys[key] = loader.construct_object(value_node, deep=True)
    return keys


_UniqueKeyLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def read_yaml(path: Path, example: str) -> dict[str, Any]:
    """Return the keys of a YAML file.

    example : a sound file of this kind, which messages name

    Raises
    ------
    ConfigError : the file is not YAML, or no mapping of names, or has a key twice
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeyLoader)
    except ConfigError as error:
        raise ConfigError(error.what, where=path, place=error.place, remedy=error.remedy) from None
    except NOT_YAML as error:
        raise _not_yaml(error, path, example) from None
    if not isinstance(data, dict):
        raise ConfigError("the file holds no keys", where=path, remedy=f"Start from {example}.")
    strange = next((key for key in data if not isinstance(key, str)), None)
    if strange is not None:
        raise ConfigError(f"the key {strange!r:.60} is not text", where=path, remedy="Write name: value.")
    return data


def _not_yaml(error: Exception, path: Path, example: str) -> ConfigError:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        place = f"line {mark.line + 1} column {mark.column + 1}"
        tab = "\\t" in str(error.problem)
        remedy = "Indent with blanks, not with tabs." if tab else "Correct the line, or the one before it."
        return ConfigError(f"the file is not YAML: {error.problem}", where=path, place=place, remedy=remedy)
    if isinstance(error, RecursionError):
        return ConfigError("the file is nested too deeply", where=path, remedy=f"Start from {example}.")
    if isinstance(error, UnicodeDecodeError):
        return ConfigError(
            "the file is not UTF-8 text", where=path, place=f"byte {error.start}", remedy="Save it as UTF-8."
        )
    if isinstance(error, yaml.reader.ReaderError):
        what = f"the file is not YAML: the character #x{error.character:02x} is not allowed"
        return ConfigError(what, where=path, place=f"character {error.position}", remedy="Remove it.")
    if not isinstance(error, yaml.YAMLError):
        return ConfigError(f"a value of the file can't be read: {error}", where=path, remedy="Put text in quotes.")
    return ConfigError(f"the file is not YAML: {error}", where=path, remedy=f"Start from {example}.")


AnySection = TypeVar("AnySection", bound=Section)


def read_section(
    section: type[AnySection],
    texts: Sequence[str],
    *,
    option: str,
    example: str,
    given: Mapping[str, Any] | None = None,
) -> AnySection:
    """Return a section with some of its keys set, and the default of every other key.

    Parameters
    ----------
    texts : ``key=value`` or ``section.key=value`` each; the value is YAML; a later text replaces an earlier one
    option : the command's option that has the texts, for messages; example : a text that is right
    given : keys that are set before the texts

    Raises
    ------
    ConfigError : a text is not of that form, an unknown key, or a value that is not allowed
    """
    data = dict(given or {})
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ConfigError(f"{text!r} is not KEY=VALUE", place=option, remedy=f"Example: {option} {example}")
        origin = f"{option} {key}"
        put(data, key.split("."), yaml_value(value, origin), origin)
    try:
        return section.model_validate(data)
    except ValidationError as error:
        raise config_error(error, option, section) from None


def yaml_value(text: str, origin: str) -> Any:
    """Parse a value. `origin` names the option or variable in messages.

    Raises
    ------
    ConfigError : the text is not YAML
    """
    try:
        return yaml.safe_load(text)
    except NOT_YAML as error:
        deep = isinstance(error, RecursionError)
        problem = "it is nested too deeply" if deep else getattr(error, "problem", None) or error
        raise ConfigError(
            f"{origin}: the value is not YAML: {problem}", remedy='Put text with special characters in quotes: "…"'
        ) from None


def put(data: dict[str, Any], keys: Sequence[str], value: Any, origin: str) -> None:
    """Set the value at the path `keys` in `data`, and make the sections of the path that are missing. Entries of lists
    count from 0.

    Raises
    ------
    ConfigError : the path goes through a value, or to an entry that a list does not have
    """
    at: Any = data
    for key in keys[:-1]:
        if isinstance(at, list):
            at = _item(at, key, origin)
            continue
        # A section whose keys are all commented out reads as nothing.
        inner = {} if at.get(key) is None else at[key]
        at[key] = inner
        at = inner
        if not isinstance(at, dict | list):
            raise ConfigError(f"{origin}: {key!r} holds a value, not keys", remedy="Name a key inside a section.")
    if isinstance(at, list):
        _item(at, keys[-1], origin)
        at[int(keys[-1])] = value
    else:
        at[keys[-1]] = value


def _item(items: list[Any], key: str, origin: str) -> Any:
    if not key.isdigit() or int(key) >= len(items):
        raise ConfigError(
            f"{origin}: there is no entry {key!r} in a list of {len(items)}", remedy="Entries count from 0."
        )
    return items[int(key)]


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


def export_folder(config: Config, where: Path | None = None) -> Path:
    """Return the folder of the configuration's export.

    where : the configuration's file, for the message

    Raises
    ------
    ConfigError : none is named
    """
    if config.export is None:
        raise ConfigError(
            "no export folder is named",
            where=where,
            place="export",
            remedy="Set export: FOLDER, or --set export=FOLDER.",
        )
    return config.export


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
        return _unknown(location[-1], _allowed(location[:-1], model))
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

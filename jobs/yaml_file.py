"""Read YAML that a person wrote, from a file or an option. Every fault is one error with its place."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any, Final

import yaml

from schemas.errors import ConfigError

__all__ = ["NOT_YAML", "read_yaml"]

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

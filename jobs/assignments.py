"""Read texts ``KEY=VALUE`` of the command line: each sets one key of a configuration or of a section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from jobs.config_faults import config_error
from jobs.yaml_file import NOT_YAML
from schemas.config.section import Section
from schemas.errors import ConfigError

__all__ = ["put", "read_section", "yaml_value"]

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

"""Generate ``docs/configuration.md``, which lists every configuration key and the stages that read the key.

``python docs/site/configuration.py`` renews it.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel, JsonValue
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from factory.stage import Unit
from jobs.pipeline import build_pipeline
from schemas.canonical import JSON
from schemas.config import Config, InstructionCell, InstructionsConfig, SourceConfig

__all__ = ["FILE", "Key", "configuration_page", "keys", "makes_stale"]

FILE: Final = Path(__file__).resolve().parents[1] / "configuration.md"

NO_STAGE: Final = {
    "name": "nothing; another name is another ref",
    "store": "nothing; another store is empty",
    "export": "nothing",
    "sources": "scenes that are new; those left out are removed",
    "sources.N.family": "scenes that are new; those left out are removed",
    "sources.N.root": "scenes whose files differ",
    "sources.N.scenes": "scenes that are new; those left out are removed",
    "sources.N.exclude": "scenes that are new; those left out are removed",
    "sources.N.regions": "scenes whose files differ",
    "sources.N.houses": "scenes whose files differ",
    "sources.N.connectivity": "scenes whose files differ, and the export",
    "splits": "the export",
    "ray": "nothing",
    "keep": "nothing",
}
"""What a key makes stale if no stage has it in its key, by key or by section."""


@dataclass(frozen=True, slots=True)
class Key:
    """One configuration key: its path (with N for a position in a list), type, unit, default and description."""

    path: str
    type: str
    unit: str
    default: str
    about: str


def keys() -> Iterator[Key]:
    """Yield every key of the configuration: those of a section in order, then those of the sections in it."""
    for path, model in _sections():
        yield from _keys(path, model)


def _sections(model: type[BaseModel] = Config, path: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    yield path, model
    for name, field in model.model_fields.items():
        section, listed = _section(field.annotation)
        if section is not None:
            yield from _sections(section, f"{path}{name}.N." if listed else f"{path}{name}.")


def _keys(path: str, model: type[BaseModel]) -> Iterator[Key]:
    for name, field in model.model_fields.items():
        section, listed = _section(field.annotation)
        if section is None or listed:
            yield Key(
                path + name,
                _type(field.annotation),
                _unit(field),
                _default(field),
                " ".join((field.description or "").split()),
            )


def makes_stale(path: str) -> tuple[str, ...]:
    """Return the names of the stages and aggregates whose results a change of one configuration key makes stale. The
    stages come first, in the order of the pipeline.
    """
    if path in NO_STAGE:
        return ()
    parts = [part for part in path.split(".") if part != "N"]
    return tuple(name for name, read in _read(_sample()).items() if _holds(read, parts))


def _read(config: Config) -> dict[str, JSON]:
    """Return, for each stage and aggregate by name, the part of the configuration that it reads, in the form that
    enters the key of the stage or aggregate.
    """
    pipeline = build_pipeline(config)
    unit = Unit("replicacad/x", "replicacad", payload={"scene_id": "x", "navmesh": "navmeshes", "absence": "never"})
    read: dict[str, JSON] = {stage.name: stage.parameters(unit) for stage in pipeline.stages}
    return read | {aggregate.name: aggregate.parameters() for aggregate in pipeline.aggregates}


def _sample() -> Config:
    """Return a configuration for which every stage reads all the keys that it can ever read. It therefore has every
    section, and a cell with a bounded number of words.
    """
    return Config(
        name="x",
        store="x",
        sources=(SourceConfig(family="replicacad", root=Path("x")),),
        instructions=InstructionsConfig(cells=(InstructionCell(category="simple", words=(1, 99), count=1),)),
    )


def _holds(document: JSON, parts: list[str]) -> bool:
    for part in parts:
        if not isinstance(document, Mapping):
            return True  # a list is read whole
        if part not in document:
            return False
        document = document[part]
    return True


def configuration_page() -> str:
    """Return the text of ``docs/configuration.md``."""
    parts = [
        "# The configuration",
        "Made from the models in `schemas/config` by `python docs/site/configuration.py`.",
        "One YAML file. Relative folders count from the folder of that file. `--set a.b=value` and the variable "
        "`CONDVLN_A__B=value` override a key; entries of a list are numbered from 0, as in `sources.0.root`. Unknown "
        "keys are errors.",
        "*Makes stale* names the stages that read the key: a run after a change does these again for every scene, and "
        "later stages only where their input changed. Stages in their order: `scene`, `counts`, `relations`, "
        "`visibility`, `episodes`, `text`; `priors` are the sums of `counts` over all scenes. `episodes` reads the "
        "wording (`instructions.language`, `voices`, `length`) only where a cell bounds `words`. The export is written "
        "again after each run.",
    ]
    head = ["| key | type | unit | default | what it does | makes stale |", "|---|---|---|---|---|---|"]
    for path, model in _sections():
        rows = []
        for key in _keys(path, model):
            cells = (f"`{key.path}`", key.type, key.unit, key.default, key.about, _stale(key.path))
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        if rows:
            about = (model.__doc__ or "").strip().replace("\n    ", "\n")
            parts += [f"## {path.removesuffix('.') or 'The run'}", about, "\n".join([*head, *rows])]
    return "\n\n".join(parts) + "\n"


def _stale(path: str) -> str:
    stages = makes_stale(path)
    if stages:
        return ", ".join(f"`{name}`" for name in stages)
    return NO_STAGE[path] if path in NO_STAGE else NO_STAGE[path.partition(".")[0]]


def _section(annotation: Any) -> tuple[type[BaseModel] | None, bool]:
    """Return the section that a key holds, and whether the key holds a list of such sections."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, False
    if get_origin(annotation) is tuple:
        inner = get_args(annotation)[0]
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            return inner, True
    return None, False


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is typing.Annotated:
        return _type(arguments[0])
    if origin in (Union, types.UnionType):
        return " or ".join("none" if inner is type(None) else _type(inner) for inner in arguments)
    if origin is Literal:
        return ", ".join(f"`{choice}`" for choice in arguments)
    if origin is tuple:
        inner = [_type(argument) for argument in arguments if argument is not ...]
        return f"list of {inner[0]}" if arguments[-1] is ... else f"[{', '.join(inner)}]"
    if origin is dict:
        return f"mapping of {_type(arguments[0])} to {_type(arguments[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "entry"
    return {
        float: "number",
        int: "whole number",
        bool: "true or false",
        str: "text",
        Path: "path",
        JsonValue: "any value",
    }[annotation]


def _unit(field: FieldInfo) -> str:
    """Return the unit of a key, from the metadata of its field or of the numbers inside it; empty if there is none."""
    found: list[object] = [field.json_schema_extra]
    pending: list[Any] = [field.annotation]
    while pending:
        annotation = pending.pop()
        pending += get_args(annotation) if get_origin(annotation) is not Literal else ()
        found += [getattr(part, "json_schema_extra", None) for part in getattr(annotation, "__metadata__", ())]
    return next((str(extra["unit"]) for extra in found if isinstance(extra, dict) and "unit" in extra), "")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    assert default is not PydanticUndefined
    if default is None:
        return "none"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple):
        return f"[{', '.join(map(_shown, default))}]"
    if isinstance(default, dict):
        return ", ".join(f"{name}: {value}" for name, value in default.items()) or "empty"
    return _shown(default)


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else f"`{value}`" if isinstance(value, str) else str(value)


if __name__ == "__main__":
    FILE.write_text(configuration_page(), encoding="utf-8")

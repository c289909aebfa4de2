"""The record of what an export was made of, and the check whether later changes explain a smaller export.

``origin.json`` stands in each export: the configuration, the versions of the code, the priors, and for each scene its
status, its files' hash, its key and its episodes. The next export is compared with it. A smaller export is accepted
where the configuration, the code or a source changed; where none of them did, published episodes were lost.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any, Final

import orjson
from pydantic import Field, ValidationError

from condvln.export.contents import ORIGIN, document_digest, read_document, read_index
from condvln.manifest import manifest_paths
from factory.snapshot import Snapshot
from jobs.pipeline import code_versions
from jobs.settings import config_error, put
from schemas.base import Document
from schemas.config import Config
from schemas.errors import SmallerExportError, UsageError

__all__ = ["Origin", "SceneOrigin", "Shrinkage", "refuse_losses"]

LOST_NAVMESH: Final = "the navmesh built for its scene is missing or changed"
_KEPT_OUT: Final = {"store", "export", "ray", "keep", "name"}
"""Sections of the configuration that do not affect the content of an export."""
_KEPT_OUT_OF_SPLITS: Final = {"bias", "sharded"}
_PATHS: Final = {"root", "regions", "houses", "connectivity"}
"""Keys of a source that are paths on a machine."""
_SHOWN: Final = 5
_LAST_STAGE: Final = "text"
_FIRST_STAGE: Final = "scene"


class SceneOrigin(Document):
    """One scene, as recorded in its snapshot."""

    status: str
    """Status: ok, skipped or quarantined."""
    data: str = ""
    """Hash of the scene's files."""
    key: str = ""
    """Key of the scene's last stage: equal keys mean equal episodes."""
    episodes: int = 0
    """Number of episodes in the snapshot, exported or not."""


class Origin(Document):
    """Content of ``origin.json``."""

    snapshot: str
    configuration: dict[str, Any] = Field(default_factory=dict)
    """Values of the configuration by key, such as ``instructions.moves``; without folders."""
    code: dict[str, int] = Field(default_factory=dict)
    """Version of each stage, of the priors, and of the choice of episodes (as ``select``)."""
    priors: dict[str, str] = Field(default_factory=dict)
    scenes: dict[str, SceneOrigin] = Field(default_factory=dict)
    """Scenes by ``<source>/<scene>``."""
    digest: str = ""
    """Hash of everything else."""

    @classmethod
    def of(cls, config: Config, snapshot: Snapshot) -> Origin:
        """Return the origin of the export that is made of `snapshot` under `config`."""
        index = snapshot.index.table
        columns = [f"{_FIRST_STAGE}.inputs", "content", f"{_LAST_STAGE}.key", f"{_LAST_STAGE}/episodes.rows"]
        known = [name for name in ("unit_id", "status", *columns) if name in index.column_names]
        scenes = {}
        for row in index.select(known).to_pylist():
            data, key = row.get("content") or row.get(columns[0]) or b"", row.get(columns[2]) or b""
            scenes[row["unit_id"]] = SceneOrigin(
                status=row["status"], data=data.hex(), key=key.hex(), episodes=row.get(columns[3]) or 0
            )
        stages = {name: totals.version for name, totals in snapshot.manifest.stages.items()}
        return cls(
            snapshot=snapshot.snapshot_id,
            configuration=_flat(_deciding(config)),
            code=code_versions(config) | stages,
            priors=dict(snapshot.manifest.aggregates),
            scenes=scenes,
        )

    @classmethod
    def read(cls, folder: Path) -> Origin | None:
        """Read the origin of the export in a folder; None if the folder has no readable record of it."""
        document = read_document(folder / ORIGIN)
        try:
            if document is None or document_digest(document) != document["digest"]:
                return None
            return cls.model_validate(document)
        except (KeyError, ValidationError):
            return None

    def as_bytes(self) -> bytes:
        """Return the content of ``origin.json`` as bytes."""
        document = self.model_dump(mode="json", exclude={"digest"})
        document["digest"] = document_digest(document)
        return orjson.dumps(document, option=orjson.OPT_INDENT_2) + b"\n"


def _deciding(config: Config) -> dict[str, Any]:
    document = config.model_dump(mode="json", exclude=_KEPT_OUT)
    sources = document.pop("sources")
    document["sources"] = {}
    document["splits"] = {name: value for name, value in document["splits"].items() if name not in _KEPT_OUT_OF_SPLITS}
    for source in sources:
        document["sources"].setdefault(source["family"], []).append(
            {name: value is not None if name in _PATHS else value for name, value in source.items()}
        )
    return document


def _flat(document: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in sorted(document.items()):
        if isinstance(value, dict) and value:
            found |= _flat(value, f"{above}{name}.")
        else:
            found[above + name] = value
    return found


def remember_data(export: Path, datasets: Mapping[str, Path]) -> None:
    """Note beside an export where its scenes lie on this machine; the export itself may be passed on."""
    texts = [f"{family}={root}" for family, root in datasets.items()]
    _data_file(export).write_bytes(orjson.dumps({"data": texts}))


def data_of(export: Path, texts: Sequence[str] | None) -> list[str]:
    """Return the given texts ``[FAMILY=]DIR`` or, without any, the noted ones whose folders are there."""
    noted = (read_document(_data_file(export)) or {}).get("data", ())
    return [*texts] if texts else [text for text in noted if Path(text.partition("=")[2]).is_dir()]


def _data_file(export: Path) -> Path:
    return export.resolve().with_name(f".{export.resolve().name}.data.json")


def config_of(export: Path, datasets: Mapping[str, Path]) -> Config:
    """Return the configuration by which an export was made, with the given folders of families as its sources; the
    default configuration if the export does not say. Keys that this release does not know are left out.

    Raises
    ------
    UsageError : no dataset is given
    ConfigError : a family is unknown
    """
    if not datasets:
        raise UsageError("no dataset was named, so no scene can be read", where=export, remedy="Add --data FAMILY=DIR.")
    data: Any = {"name": "export", "store": export / "none", "export": export}
    origin = Origin.read(export)
    made = {} if origin is None else origin.configuration
    for key, value in made.items():
        if not key.startswith("sources."):
            put(data, key.split("."), value, origin=ORIGIN)
    data["sources"] = [
        {name: value for name, value in one.items() if name not in _PATHS} | {"family": family, "root": root.resolve()}
        for family, root in datasets.items()
        for one in made.get(f"sources.{family}", [{}])
    ]
    while True:
        try:
            return Config.model_validate(data)
        except ValidationError as error:
            unknown = [fault["loc"] for fault in error.errors() if fault["type"] == "extra_forbidden"]
            if not unknown:
                raise config_error(error, export) from None
        for *above, last in unknown:
            reduce(getitem, above, data).pop(last)
            print(f"{export}: a key of another release is not read:", *above, last, file=sys.stderr)


@dataclass
class Shrinkage:
    """Reasons why an export holds fewer episodes than the one in place."""

    causes: list[str] = field(default_factory=list)
    """Changes of the configuration, the code or the sources; they are accepted."""
    losses: list[str] = field(default_factory=list)
    """Lost episodes whose inputs did not change; they are never accepted."""
    doubts: list[str] = field(default_factory=list)
    """Reasons that are neither in the configuration nor in the sources."""


def compare(
    former: Origin | None, now: Origin, *, renewed: bool = False, listed: Callable[[], set[str] | None] | None = None
) -> Shrinkage:
    """Compare what two exports were made of.

    Parameters
    ----------
    renewed : the priors were renewed on purpose
    listed : gives the scenes that the sources hold now, None where they can't be listed; asked only where some are gone
        from the snapshot
    """
    found = Shrinkage()
    if former is None:
        found.doubts.append(f"the export in place has no readable {ORIGIN}, so the changes since then are unknown")
        return found
    changed = _differing(former.configuration, now.configuration)
    if changed:
        found.causes.append(f"the configuration changed ({_some(changed)})")
    versions = _differing(former.code, now.code)
    if versions:
        found.causes.append(f"the code changed ({_some(versions)})")
    elif former.priors != now.priors and renewed:
        found.causes.append("the label priors were renewed")
    explained = bool(changed or versions or (renewed and former.priors != now.priors))
    _gone(former, now, found, changed, listed)
    by_kind: dict[str, list[str]] = {}
    for name, here in now.scenes.items():
        before = former.scenes.get(name)
        kind = "new" if before is None else _kind(before, here, explained)
        if kind:
            by_kind.setdefault(kind, []).append(name)
    for kind, names in sorted(by_kind.items()):
        target, what = _KINDS[kind]
        getattr(found, target).append(f"{what}: {_scenes(names)}")
    return found


_KINDS: Final = {
    "lost": ("losses", "fewer episodes in the snapshot although their inputs did not change"),
    "quarantine": ("doubts", "in quarantine although their files, the configuration and the code are as before"),
    "other": ("doubts", "fewer episodes although their files, the configuration and the code are as before"),
    "data": ("causes", "their files in the source changed"),
    "new": ("causes", "new in the source"),
    "explained": ("causes", "fewer episodes because of these changes"),
    "skipped": ("causes", "skipped now"),
}
"""For each kind of change: the list of `Shrinkage` that it goes to, and its wording."""


def _kind(before: SceneOrigin, here: SceneOrigin, explained: bool) -> str:
    """Return how a scene changed between two exports: ``lost``, ``data``, ``explained``, ``quarantine``, ``skipped`` or
    ``other``; an empty text if the scene's data are the same and it has at least as many episodes as before.
    """
    fewer = before.episodes > here.episodes
    if fewer and here.status == "ok" and before.key and before.key == here.key:
        return "lost"
    if before.data != here.data:
        return "data"
    if not fewer:
        return ""
    if explained:
        return "explained"
    return {"quarantined": "quarantine", "skipped": "skipped"}.get(here.status, "other")


def _gone(
    former: Origin, now: Origin, found: Shrinkage, changed: list[str], listed: Callable[[], set[str] | None] | None
) -> None:
    """Classify each scene that the snapshot no longer has as removed from its source, lost, or belonging to a missing
    source, and add the result to `found`.
    """
    gone = {name for name, scene in former.scenes.items() if scene.episodes and name not in now.scenes}
    if not gone:
        return
    there = listed() if listed is not None else set()
    if there is None:
        found.doubts.append(f"the sources can't be listed here, so it is not known whether they hold {_scenes(gone)}")
        return
    still = gone & there
    if still:
        found.losses.append(f"in their source and not in the snapshot: {_scenes(still)}")
    left = {_family(name) for name in now.scenes}
    configured = {key.split(".")[1] for key in now.configuration if key.startswith("sources.")}
    asked_otherwise = {key.split(".")[1] for key in changed if key.startswith("sources.")}
    empty = {_family(name) for name in gone - still} & configured - left - asked_otherwise
    for family in sorted(empty):
        found.doubts.append(f"the source {family} has no scene any more; is its folder mounted and complete?")
    removed = {name for name in gone - still if _family(name) not in empty}
    if removed:
        found.causes.append(f"no longer in their source: {_scenes(removed)}")


def _family(name: str) -> str:
    return name.split("/", 1)[0]


def _differing(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    missing = object()
    return sorted(key for key in {*one, *other} if one.get(key, missing) != other.get(key, missing))


def _some(names: set[str] | list[str]) -> str:
    shown = sorted(names)
    return ", ".join(shown[:_SHOWN]) + (f" and {len(shown) - _SHOWN} more" if len(shown) > _SHOWN else "")


def _scenes(names: set[str] | list[str]) -> str:
    return f"{len(names)} scene{'s' if len(names) != 1 else ''} ({_some(names)})"


def refuse_losses(
    folder: Path, ref: str, now: Origin, episodes: Mapping[str, int], left_out: Mapping[str, int], **known: Any
) -> list[str]:
    """Raise an error if a new export holds fewer episodes than the one in ``folder`` and nothing explains why;
    otherwise return the reasons.

    Parameters
    ----------
    ref : file of the store that names the snapshot, for the message
    episodes : of the new export, by split
    left_out : of the new export, by reason
    known : ``renewed`` and ``listed`` of :func:`compare`

    Raises
    ------
    SmallerExportError : it would hold fewer, and neither the configuration nor the code nor the sources say why
    """
    before = _counts(folder)
    if before is None:
        return []
    had, have = sum(before.values()), sum(episodes.values())
    fewer = [split for split, count in before.items() if episodes.get(split, 0) < count]
    found = compare(Origin.read(folder), now, **known)
    if left_out.get(LOST_NAVMESH):
        found.losses.append(f"{left_out[LOST_NAVMESH]} episodes are left out: {LOST_NAVMESH}")
    if had and not have:
        found.doubts.append("it would be empty")
    if not fewer and not found.losses:
        return []
    if fewer and not found.causes and not found.doubts:
        found.doubts.append("neither the configuration nor the code nor a source changed")
    parts = ", ".join(f"{split} {before[split]} → {episodes.get(split, 0)}" for split in fewer)
    size = f"{had} → {have} episodes" + (f" ({parts})" if parts else "")
    if found.losses or found.doubts:
        why = "; ".join([*found.losses, *found.doubts])
        raise SmallerExportError(
            f"an export of the snapshot that {ref} names would hold less than the one in place, {size}: {why}",
            where=folder,
            remedy="The export in place is kept. Run condvln generate CONFIG --verify to make again what was lost; or, "
            "where the smaller export is wanted, condvln export CONFIG --allow-shrink.",
        )
    return [f"the export is smaller than the one before, {size}: {'; '.join(found.causes)}"]


def _counts(folder: Path) -> dict[str, int] | None:
    """Return the number of episodes of each split of the export in place, from its record or its manifests; None if
    there is neither.
    """
    index = read_index(folder)
    if index is not None and isinstance(index.get("episodes"), dict):
        return {str(split): int(count) for split, count in index["episodes"].items()}
    counts = {}
    for path in manifest_paths(folder):
        try:
            counts[path.stem] = path.read_bytes().count(b"\n")
        except OSError:
            continue
    return counts or None

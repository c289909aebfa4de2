"""``condvln sources``: list what the configured sources hold, what they lack, which scenes would be skipped or
quarantined, and what a run is expected to yield. Runs no stage.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from condvln.instructions.likeness import NO_BORDER, borders
from condvln.instructions.referents import Referents, room_refs
from condvln.labels import vocabulary
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.family import look_for
from condvln.sources.scene_source import Source
from condvln.sources.source import UNKNOWN_LABEL, SceneHandle
from jobs.pipeline import open_configured
from jobs.report import Report, Section, by_cause
from jobs.workspace import file_hashes, hasher
from schemas.config import AgentConfig, Config, SamplingConfig
from schemas.errors import ConfigError, InputError, MissingFileError

__all__ = ["SceneYield", "Survey", "scene_yield", "survey", "survey_source"]

SHOWN: Final = 20
"""Number of scenes and labels listed on a terminal; ``--json`` has all of them."""
ENOUGH: Final = 6
"""Number of objects of a room with which something can usually be asked about it."""
FEW: Final = f"with fewer than {ENOUGH} objects in each room, often nothing can be asked; put about {ENOUGH} in a room"


def survey(config: Config, *, limit: int | None = None, console: Console | None = None) -> Report:
    """Survey every configured source: files, scenes, rooms, objects, labels, and what a run would leave out.

    limit : most scenes read of each source; all where None
    """
    hashes = file_hashes(config)
    document: list[dict[str, Any]] = []
    sections: dict[str, list[tuple[Any, ...]]] = {name: [] for name in _COLUMNS}
    for source in config.sources:
        try:
            opened = open_configured(config, source, hasher(hashes))
            handles = opened.handles()
        except (ConfigError, InputError) as error:  # InputError: a file that all scenes share can't be read
            document.append({"family": source.family, "root": str(source.root), "error": str(error)})
            sections["Not a dataset"].append((source.family, str(error)))
            continue
        hashes.save()
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, console=console or Console(stderr=True), transient=True) as progress:
            task = progress.add_task(f"reading {source.family}", total=min(len(handles), limit or len(handles)))
            found = survey_source(
                opened,
                handles,
                config.agent,
                anchor_size=config.sampling.anchor_size,
                limit=limit,
                tick=partial(progress.advance, task),
            )
        inputs = {i.path: i.size for handle in handles for i in handle.inputs}
        kinds = look_for(source.family, source.root, source.houses)
        document.append(
            {
                "family": source.family,
                "root": str(source.root),
                "inputs": len(inputs),
                "bytes": sum(inputs.values()),
                "files": [
                    {"holds": k.download.holds, "need": k.download.need, "files": k.files, "from": k.download.source}
                    for k in kinds
                ],
                "absent": [h.scene_id for h in handles if not h.inputs and type(h.fault) is MissingFileError],
                **vars(found),
                "yields": [asdict(one) for one in found.yields],
                "without_extent": found.without_extent,
            }
        )
        family = source.family
        sections["Sources"].append((family, str(source.root), len(inputs), sum(inputs.values()) / 2**20))
        sections["Scenes"].append((family, *(getattr(found, name) for name in _COUNTED)))
        sections["Missing files"] += [
            (family, k.download.need, k.download.holds, k.download.source, k.download.licence)
            for k in kinds
            if not k.files
        ]
        sections["Navmeshes"] += [(family, origin, count) for origin, count in sorted(found.navmeshes.items())]
        sections["Will yield"].append((family, *_yield_row(found)))
        sections["Will yield nothing"] += [(family, y.scene_id, y.nothing) for y in found.yields if y.nothing][:SHOWN]
        sections["May yield nothing"] += [(family, y.scene_id, y.most, FEW) for y in found.yields if y.doubtful][:SHOWN]
        sections["Unmapped labels"] += [
            (family, raw, count, _may_be(raw, family)) for raw, count in found.unmapped_labels.most_common(SHOWN)
        ]
        sections["Unmapped rooms"] += [(family, *item) for item in found.unmapped_rooms.most_common(SHOWN)]
        sections["Warnings"] += [(family, *item) for item in sorted(found.warnings.items())]
        sections["Passed over"] += [(family, *item) for item in found.passed_over[:SHOWN]]
        sections["Will be skipped"] += [(family, *item) for item in found.skipped[:SHOWN]]
        sections["Unreadable"] += [(family, *item) for item in by_cause(found.unreadable)[:SHOWN]]
    # What was asked for and is not there: a source that can't be used, a scene or pattern that nothing fits.
    absent = any("error" in one or one["absent"] for one in document)
    unread = [one for one in document if "error" not in one and one["unreadable"] and not one["read"]]
    lines = [
        f"{one['family']}: {len(one[what]) - SHOWN} more {what.replace('_', ' ')} are not shown; --json lists them"
        for one in document
        for what in ("passed_over", "skipped", "unreadable")
        if what in one and len(one[what]) > SHOWN
    ]
    shown = [Section(n, _COLUMNS[n], [*rows]) for n, rows in sections.items()]
    lines += [f"{one['family']}: none of its {one['scenes']} scenes can be read" for one in unread]
    code = ConfigError.exit_code if absent else InputError.exit_code if unread else 0
    return Report({"sources": document}, lines, shown, exit_code=code)


_COLUMNS: Final = {
    "Not a dataset": ("family", "why"),
    "Sources": ("family", "root", "files and entries", "MiB"),
    "Scenes": ("family", "scenes", "read", "rooms", "objects", "with extent", "without extent"),
    "Missing files": ("family", "need", "what", "from", "licence to accept"),
    "Navmeshes": ("family", "navmesh", "scenes"),
    "Will yield": (
        "family",
        "scenes with a room of six objects",
        "with fewer",
        "no instructions",
        "with claims of absence",
        "(room, label) pairs never called absent",
        "nameless objects",
        "hidden objects",
    ),
    "Will yield nothing": ("family", "scene", "why"),
    "May yield nothing": ("family", "scene", "most in a room", "why"),
    "Unmapped labels": ("family", "raw label", "objects", "may be"),
    "Unmapped rooms": ("family", "raw label", "rooms"),
    "Warnings": ("family", "code", "places"),
    "Passed over": ("family", "path", "why"),
    "Will be skipped": ("family", "scene", "why"),
    "Unreadable": ("family", "scene", "cause"),
}


def _yield_row(found: Survey) -> tuple[int, ...]:
    some = [one for one in found.yields if not one.nothing]
    doubtful = sum(one.doubtful for one in some)
    return (
        len(some) - doubtful,
        doubtful,
        len(found.yields) - len(some),
        sum(one.absence > 0 for one in some),
        *(sum(getattr(one, name) for one in found.yields) for name in ("blocked", "nameless", "hidden")),
    )


def _may_be(raw: str, family: str) -> str:
    """Return, as one text, the labels that an object of an unmapped type may have. No instruction may say that a thing
    with one of these labels is absent.
    """
    label = vocabulary.canonical(raw, family)
    if vocabulary.is_vague(label, family):
        return "anything of its size"
    return ", ".join(sorted(vocabulary.may_be(label, family))) or "nothing that text names"


_COUNTED: Final = ("scenes", "read", "rooms", "objects", "with_extent", "without_extent")


@dataclass
class Survey:
    """Counts over the scenes that were read.

    scenes : scenes listed; read : those among them that were read
    unmapped_labels : objects by raw label that the vocabulary does not know (they never appear in text)
    warnings : by code, how many places; skipped, unreadable : (scene id, why)
    passed_over : (path, why) of what holds no scene, or is listed under another name
    navmeshes : scenes by where their navmesh comes from
    yields : what to expect of each scene that was read
    """

    scenes: int = 0
    read: int = 0
    rooms: int = 0
    objects: int = 0
    with_extent: int = 0
    unmapped_labels: Counter[str] = field(default_factory=Counter)
    unmapped_rooms: Counter[str] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)
    navmeshes: Counter[str] = field(default_factory=Counter)
    passed_over: list[tuple[str, str]] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)
    unreadable: list[tuple[str, str]] = field(default_factory=list)
    yields: list[SceneYield] = field(default_factory=list)

    @property
    def without_extent(self) -> int:
        """Return the number of objects of unknown extent."""
        return self.objects - self.with_extent


def survey_source(
    source: Source,
    handles: Sequence[SceneHandle],
    agent: AgentConfig,
    *,
    anchor_size: float = SamplingConfig().anchor_size,
    limit: int | None = None,
    tick: Callable[[], object] | None = None,
) -> Survey:
    """Read scenes of a dataset and count their content.

    Parameters
    ----------
    handles : the scenes, as ``source.handles()`` lists them
    agent : whose navmesh is looked for
    anchor_size : least longest side of a thing that names a room, metres
    limit : most scenes read, spread evenly over the list; all where None
    tick : called after each scene
    """
    survey = Survey(scenes=len(handles), passed_over=source.passed_over())
    survey.unreadable += [(h.scene_id, str(h.fault)) for h in handles if h.fault is not None]
    sound = [h.scene_id for h in handles if h.fault is None]
    if limit is not None and len(sound) > limit:
        sound = [sound[k * len(sound) // limit] for k in range(limit)]
    for scene_id in sound:
        try:
            scene = with_shipped_navmesh(source.read(scene_id), agent)
            _count(survey, source, scene)
            survey.yields.append(scene_yield(scene, anchor_size))
        except InputError as error:
            survey.unreadable.append((scene_id, str(error)))
        if tick is not None:
            tick()
    return survey


def _count(survey: Survey, source: Source, scene: Scene) -> None:
    survey.read += 1
    survey.rooms += len(scene.rooms)
    survey.objects += len(scene.objects)
    survey.with_extent += sum(item.box is not None or item.radius is not None for item in scene.objects)
    survey.warnings.update(warning.code for warning in scene.warnings)
    survey.unmapped_labels.update(
        # A model whose source labels it wrongly goes by its own name.
        item.raw_label if vocabulary.canonical(item.raw_label, scene.family) == item.label else item.label
        for item in scene.objects
        if item.raw_label != UNKNOWN_LABEL and item.label not in vocabulary.labels
    )
    survey.unmapped_rooms.update(
        room.raw_label for room in scene.rooms if room.annotation != "scene" and _unknown_room(room.raw_label, scene)
    )
    if len(scene.objects) < 2:
        survey.skipped.append((scene.scene_id, f"{len(scene.objects)} objects: nothing to relate or to choose between"))
    origin = _navmesh_origin(source, scene)
    survey.navmeshes[origin] += 1
    if origin == "none":
        why = "no navmesh, and neither mesh nor walls to build one from: instructions without episodes"
        survey.skipped.append((scene.scene_id, why))


def _unknown_room(raw: str, scene: Scene) -> bool:
    label = vocabulary.room_type(raw, scene.family)
    return raw != UNKNOWN_LABEL and label not in vocabulary.room_labels


def _navmesh_origin(source: Source, scene: Scene) -> str:
    if scene.navmesh is not None:
        return "shipped, fits" if scene.navmesh.fits else "shipped, for another agent"
    # A scan's mesh is there or not; opening it, which may take a minute, would tell no more.
    if scene.stage or source.geometry(scene) is not None:
        return "to be built"
    return "none"


@dataclass(frozen=True, slots=True)
class SceneYield:
    """The expected output of a run for one scene.

    nothing : why there will be no instructions; empty where there may be some
    rooms, named : its rooms, and those that text can tell apart
    absence : rooms where something can be said to be absent
    blocked : (room, label) pairs whose absence would be claimed, were it not for something that may bear the label
    nameless : objects of no label of their own that block some; hidden : objects in something shut
    most : most objects of one room that text can name
    """

    scene_id: str
    nothing: str
    rooms: int
    named: int
    absence: int
    blocked: int
    nameless: int
    hidden: int
    most: int

    @property
    def doubtful(self) -> bool:
        """Return whether there may be instructions, and yet no room has as many objects as usually do."""
        return not self.nothing and self.most < ENOUGH


@dataclass(frozen=True, slots=True)
class _NoFacts:
    """A stand-in for a scene's facts that knows no relations, so that only labels can name rooms."""

    status: Mapping[str, NDArray[np.int8]]
    margin: Mapping[str, NDArray[np.float64]]
    denied: Mapping[str, NDArray[np.bool_]]
    excluded: Mapping[str, NDArray[np.bool_]]

    def between(self, pairs: NDArray[np.intp]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return np.zeros((0, len(pairs)), np.int8), np.zeros((0, len(pairs)))

    def closest(self, rival: NDArray[np.bool_]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return np.zeros(rival.shape, np.int8), np.zeros(rival.shape)

    def sizes(self, rival: NDArray[np.bool_]) -> Mapping[str, NDArray[np.int8]]:
        return {}


def scene_yield(scene: Scene, anchor_size: float) -> SceneYield:
    """Predict the output of a run for a scene, from its rooms and labels.

    anchor_size : least longest side of a thing that names a room, metres
    """
    facts, astride = _NoFacts({}, {}, {}, {}), borders(scene)
    referents = [
        Referents.of(
            room,
            scene.arrays(room.room_id),
            facts,
            vocabulary,
            anchor_size,
            scene.family,
            border=astride.get(room.room_id, NO_BORDER),
        )
        for room in scene.rooms
    ]
    named = room_refs(referents, vocabulary) if referents else {}
    everywhere = {label for label in vocabulary.labels if vocabulary.fit_for_text(label)}
    absence = blocked = 0
    for one in referents:
        if not one.complete or not one.room.asked:
            continue
        elsewhere = everywhere
        if not scene.single_room:
            elsewhere = everywhere & {o.label for o in scene.objects if o.room_id != one.room.room_id}
        lacking = {x for x in elsewhere if vocabulary.overlapping(x).isdisjoint(one.arrays.labels)}
        sure = {x for x in lacking if one.lacks(x, vocabulary)}
        absence += bool(sure)
        blocked += len(lacking - sure)
    return SceneYield(
        scene_id=scene.scene_id,
        nothing=_nothing(scene, referents, bool(named)),
        rooms=len(scene.rooms),
        named=len(named),
        absence=absence,
        blocked=blocked,
        nameless=sum(
            bool(vocabulary.may_be(item.label, scene.family, None if item.size is None else float(item.size.max())))
            for item in scene.objects
        ),
        hidden=sum(item.hidden for item in scene.objects),
        most=max((int(one.nameable.sum()) for one in referents), default=0),
    )


def _nothing(scene: Scene, referents: list[Referents], named: bool) -> str:
    if len(scene.objects) < 2:
        return "fewer than two objects: nothing to relate or to choose between"
    if not any(one.room.asked for one in referents):
        return "its annotation was checked by nobody, so no room is asked; 'absence: never' asks what claims no absence"
    if not named:
        return "no room has a name of its own"
    if sum(int(one.nameable.sum()) for one in referents) < 2:
        return "fewer than two objects that text can name"
    return ""

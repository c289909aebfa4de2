"""A survey of a dataset on disk: its content and the expected output of a run, estimated without running a stage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from condvln.labels import vocabulary
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.source import UNKNOWN_LABEL, SceneHandle, Source
from jobs.scene_yield import SceneYield, scene_yield
from schemas.config import AgentConfig, SamplingConfig
from schemas.errors import InputError

__all__ = ["Survey", "survey_source"]


@dataclass
class Survey:
    """Counts over the scenes that were read.

    scenes : scenes listed; read : those among them that were read
    unmapped : objects by raw label that the vocabulary does not know (they never appear in text)
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
    unmapped: Counter[str] = field(default_factory=Counter)
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
    survey.unmapped.update(
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

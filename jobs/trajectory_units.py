"""The units of ``condvln trajectories``: the scenes of a split, with their episodes and their source files."""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from condvln.export.contents import read_index
from condvln.manifest import ManifestLine, manifest_lines, manifest_path, manifest_paths
from condvln.sources.source import HashFile, SceneHandle
from condvln.trajectories.cameras import MAIN, modality
from condvln.trajectories.uninavid import REDUCED
from factory.machine import slowness
from factory.unit import InputFile, Unit
from jobs.configuration import load_config
from jobs.looker import datasets_of
from jobs.pipeline import BYTES_BASE, open_configured, scene_payload
from schemas.config import CameraConfig, Config, SourceConfig, TrajectoryConfig
from schemas.errors import FormatError, InputError, MissingFileError, UsageError

__all__ = [
    "Estimate",
    "Frames",
    "Target",
    "configured",
    "estimate",
    "find_target",
    "list_units",
    "scene_handles",
    "scene_unit",
]

PIXEL_SECONDS: Final = 5e-8
"""Expected CPU seconds of rendering and encoding one pixel on the reference machine."""
HEADER_BYTES: Final = {"rgb": 600.0, "depth": 0.0}
"""Bytes of an image file of any size: the tables of a JPEG."""
EDGE_BYTES: Final = {"rgb": 24.5, "depth": 65.0}
"""Expected further bytes of an image file for each pixel of the edge of a square image of its size.

Means of whole files over ReplicaCAD, ProcTHOR and made scenes at 224 × 224 and 640 × 480: 20 to 35, and 38 to 92 for
depth. A larger image shows the same edges, so its size grows with its edge rather than with its area.
"""
STEPS_PER_METRE: Final = 6.0
"""Expected actions for each metre of a route, turns included."""
MOST_METRES: Final = 1e5
"""Length of a route above which a manifest is taken for damaged. The longest routes of buildings have some hundred."""
LEAST_STEPS: Final = 8.0
"""Expected actions of a walk of no length."""
LOOK_STEPS: Final = 25.0
"""Expected actions for looking at the evidence of one condition of the gold route, with the way there and back. Means
over made scenes of three families: 20 to 32.
"""
SHARED: Final = {"recovery": 0.65, "exploration": 0.35}
"""Share of the gold walk's frames whose poses a walk of this kind repeats. Means over made scenes of three families:
0.60 to 0.72 and 0.31 to 0.42.
"""
FORKED: Final = 0.4
"""Share of a gold walk's frames whose poses another gold walk from the same start has, too, until the two part."""
FILMED: Final = 8.0
"""A walk of n frames has n² / `FILMED` frames in Uni-NaVid's videos: one video for every fourth frame, of all frames so
far.
"""


@dataclass(frozen=True)
class Target:
    """The export whose episodes are walked, and the datasets whose scenes are seen.

    roots : folders in which navmeshes are searched, the export first
    texts : how the export's texts were rendered
    """

    export: Path
    split: str
    roots: tuple[Path, ...]
    config: Config
    texts: dict[str, Any] = field(default_factory=dict)
    snapshot: str = ""


def find_target(
    text: str, split: str, scenes: Sequence[str] = (), roots: Sequence[Path] = (), overrides: Sequence[str] = ()
) -> Target:
    """Return the target that the argument CONFIG|EXPORT names.

    scenes : ``FAMILY=FOLDER`` each, the datasets of an export

    Raises
    ------
    UsageError : it names neither, there is no such split, or no dataset is named
    """
    path = Path(text)
    if path.is_dir():
        export = path.resolve()
        config = configured(scenes)
    else:
        config = load_config(path, overrides)
        if config.export is None:
            raise UsageError("the configuration names no export", where=path, place="export", remedy="Set export: DIR.")
        export = config.export
    known = [found.stem for found in manifest_paths(export)]
    if split not in known:
        raise UsageError(
            f"there is no split {split!r}",
            where=export,
            remedy=f"Choose one of {', '.join(known)}." if known else "Name the folder that condvln export wrote.",
        )
    index = read_index(export) or {}
    texts = index.get("texts")
    return Target(
        export,
        split,
        (export, *(root.resolve() for root in roots), *(source.root for source in config.sources)),
        config,
        texts if isinstance(texts, dict) else {},
        str(index.get("snapshot", "")),
    )


def configured(scenes: Sequence[str]) -> Config:
    """Return a configuration whose sources are the named datasets; the rest of it is not used."""
    roots = datasets_of(scenes)
    if not roots:
        raise UsageError(
            "no dataset was named, so nothing can be seen", place="--scenes", remedy="Add --scenes FAMILY=FOLDER."
        )
    sources = [{"family": family, "root": root.resolve()} for family, root in roots.items()]
    try:
        return Config.model_validate({"name": "trajectories", "store": Path(), "sources": sources})
    except ValidationError as error:
        fault = error.errors()[0]
        raise UsageError(str(fault["msg"]), place="--scenes", remedy="Example: procthor=data/houses") from None


@dataclass(frozen=True)
class Frames:
    """Expected numbers of frames.

    own : of walks that have images of their own
    rendered : distinct poses among them; the images of a pose are rendered once
    told : of all walks; an oracle walk has the images of the gold walk
    filmed : of all videos in Uni-NaVid's layout
    """

    own: float = 0.0
    rendered: float = 0.0
    told: float = 0.0
    filmed: float = 0.0

    def __add__(self, other: Frames) -> Frames:
        return Frames(
            self.own + other.own, self.rendered + other.rendered, self.told + other.told, self.filmed + other.filmed
        )


@dataclass
class _Lines:
    """The manifest lines of one scene's episodes.

    routes : starts, and starts with lengths, of the gold routes so far
    """

    numbers: list[int] = field(default_factory=list)
    size: int = 0
    frames: Frames = field(default_factory=Frames)
    routes: set[str] = field(default_factory=set)
    state: Any = field(default_factory=hashlib.sha256)


def _kinds(config: TrajectoryConfig) -> list[str]:
    """Return the kinds of walks that have images of their own: an oracle walk has those of the gold walk."""
    return sorted({"gold" if kind == "oracle" else kind for kind in config.walks})


def _walks(kind: str, config: TrajectoryConfig) -> int:
    """Return the number of walks of a kind for each episode."""
    return config.recoveries if kind == "recovery" else 1


def _metres(line: ManifestLine, length: object) -> float:
    """Return the length of an episode's route; 0 if the field is no number, which the walks refuse with its name.

    Raises
    ------
    FormatError : no route is that long, or as short
    """
    if not isinstance(length, int | float):
        return 0.0
    if not 0 <= length <= MOST_METRES:
        raise FormatError(
            f"the length of a route is not between 0 and {MOST_METRES:,.0f} m",
            where=line.path,
            place=f"line {line.number}: route_length",
            remedy="Export the split again",
        )
    return float(length)


def _frames(config: TrajectoryConfig, fields: Mapping[str, Any], metres: float, routes: set[str]) -> Frames:
    """Return the expected numbers of frames of one episode's walks.

    fields : the episode's line of the manifest
    metres : length of its route
    routes : starts, and starts with lengths, of other gold routes in the scene; those of the episode are added
    """
    length, evidence = fields.get("route_length"), fields.get("evidence")
    gold = STEPS_PER_METRE * metres + LEAST_STEPS
    more = {
        # A mistake of mean length, and as many actions to undo it.
        "recovery": config.least_mistake + config.most_mistake,
        "exploration": LOOK_STEPS * (len(evidence) if isinstance(evidence, list) else 1),
    }
    start = repr([fields.get("start_position"), fields.get("start_rotation")])
    again, forked = f"{start} {length}" in routes, start in routes
    routes |= {start, f"{start} {length}"}
    kinds = _kinds(config)
    found = Frames()
    for kind in kinds:
        each, count = gold + more.get(kind, 0.0), _walks(kind, config)
        shared = SHARED.get(kind, 0.0) * gold if "gold" in kinds else 0.0
        # Episodes of one route have the same gold walk and the same evidence; each has mistakes of its own.
        rendered = each - shared if kind == "recovery" else 0.0 if again else each - shared - FORKED * gold * forked
        told = count * (2 if kind == "gold" and "oracle" in config.walks else 1)
        found += Frames(count * each, count * rendered, told * each, told * each**2 / FILMED)
    return found


def list_units(
    target: Target, cameras: Mapping[str, CameraConfig], config: TrajectoryConfig, hash_file: HashFile
) -> list[Unit]:
    """List the scenes of the split as units, with the walks of `config` as their expected cost.

    A scene that no source has, or that can't be listed, becomes a unit that holds its error.

    Raises
    ------
    MissingFileError, FormatError : the split's manifest is missing or damaged
    """
    manifest = manifest_path(target.export, target.split)
    lines: defaultdict[tuple[str, str], _Lines] = defaultdict(_Lines)
    for line in manifest_lines(manifest):
        fields = line.fields()
        found = lines[str(fields.get("source")), str(fields.get("scene_id"))]
        found.numbers.append(line.number)
        found.size += len(line.text)
        found.state.update(hashlib.sha256(line.text).digest())
        found.frames += _frames(config, fields, _metres(line, fields.get("route_length")), found.routes)
    handles = scene_handles(target, {scene for _, scene in lines}, hash_file)
    units = []
    for (family, scene_id), found in sorted(lines.items()):
        units.append(
            scene_unit(
                family,
                scene_id,
                handles.get((family, scene_id)),
                [InputFile(f"manifest/{target.split}", found.size, found.state.hexdigest())],
                {
                    "manifest": str(manifest),
                    "lines": found.numbers,
                    "episodes": len(found.numbers),
                    "roots": [str(root) for root in target.roots],
                },
                found.frames,
                cameras,
                float(sum(_walks(kind, config) for kind in _kinds(config)) * len(found.numbers)),
            )
        )
    return units


def scene_unit(
    family: str,
    scene_id: str,
    handle: tuple[SourceConfig, SceneHandle] | None,
    inputs: Sequence[InputFile],
    payload: Mapping[str, Any],
    frames: Frames,
    cameras: Mapping[str, CameraConfig],
    walks: float = 0.0,
) -> Unit:
    """Return the unit of one scene; it holds an error if no source has the scene, or the scene can't be listed.

    inputs, payload : of the walks; those of the scene are added
    frames, walks : expected numbers of frames, and of walks that have to be found
    """
    fault = _missing(family, scene_id) if handle is None else handle[1].fault
    own: dict[str, Any] = {"scene_id": scene_id, "family": family}
    files = list(inputs)
    memory = BYTES_BASE
    if handle is not None:
        source, listed = handle
        own = scene_payload(source, scene_id)
        files += [InputFile(i.path, i.size, i.sha256) for i in listed.inputs]
        memory += 4 * sum(i.size for i in listed.inputs)
    pixels = sum(camera.width * camera.height for camera in set(cameras.values()))
    return Unit(
        unit_id=f"{family}/{scene_id}",
        partition=family,
        inputs=tuple(files),
        payload={**own, **payload, "frames": dict(asdict(frames))},
        costs={"walks": 0.02 * walks, "frames": 1.0 + frames.rendered * pixels * PIXEL_SECONDS},
        memory=memory,
        fault=fault,
    )


def scene_handles(
    target: Target, wanted: set[str], hash_file: HashFile
) -> dict[tuple[str, str], tuple[SourceConfig, SceneHandle]]:
    """Return the scenes of the split that the sources hold, each with its source. Scenes that the configuration
    excludes are left out.
    """
    found: dict[tuple[str, str], tuple[SourceConfig, SceneHandle]] = {}
    hashed = cache(hash_file)
    for source in target.config.sources:
        for handle in open_configured(target.config, source, hashed).handles():
            if handle.scene_id in wanted:
                found.setdefault((handle.family, handle.scene_id), (source, handle))
    return found


def _missing(family: str, scene_id: str) -> InputError:
    return MissingFileError(
        "no source has this scene",
        where=f"{family}/{scene_id}",
        remedy="Name its dataset: in the configuration's 'sources', or with --scenes FAMILY=FOLDER.",
    )


@dataclass(frozen=True)
class Estimate:
    """What a run is expected to make and to cost, before it starts.

    frames : frames of all walks that have images of their own
    rendered : distinct poses among them; each is rendered once for every camera
    images : image files of the hub
    gigabytes : files of the hub and of the layouts that hold copies of its images; none without images
    hours : CPU hours on this machine
    """

    scenes: int
    episodes: int
    frames: int
    rendered: int
    images: int
    gigabytes: float
    hours: float


def estimate(
    units: Sequence[Unit], cameras: Mapping[str, CameraConfig], layouts: Sequence[str] = (), *, keep: bool = True
) -> Estimate:
    """Estimate a run from the lengths of the routes.

    layouts : those that are written beside the hub
    keep : images are written; otherwise they are only rendered and hashed
    """
    frames = Frames()
    for unit in units:
        expected = unit.payload["frames"]
        assert isinstance(expected, dict)
        frames += Frames(**{name: float(str(count)) for name, count in expected.items()})
    size = sum(_image_bytes(name, camera) for name, camera in cameras.items())
    written = frames.rendered * size  # the other images of a pose are hard links to the first one
    if "lerobot" in layouts:
        written += frames.told * size
    if "uninavid" in layouts:
        written += frames.filmed * _image_bytes(MAIN, cameras[MAIN], REDUCED)
    episodes = sum(count for unit in units if isinstance(count := unit.payload["episodes"], int))
    seconds = sum(unit.cost for unit in units) * slowness()
    return Estimate(
        len(units),
        episodes,
        round(frames.own),
        round(frames.rendered),
        round(frames.own * len(cameras)),
        written / 1e9 if keep else 0.0,
        seconds / 3600,
    )


def _image_bytes(name: str, camera: CameraConfig, reduced: int = 1) -> float:
    """Return the expected bytes of an image file of a camera, with both sides reduced by a factor."""
    kind = modality(name)
    return HEADER_BYTES[kind] + math.sqrt(camera.width * camera.height) / reduced * EDGE_BYTES[kind]

"""The units of ``condvln trajectories``: the scenes of a split, with their episodes and their source files."""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from condvln.export.contents import read_index
from condvln.manifest import manifest_lines, manifest_path, manifest_paths
from condvln.sources.source import HashFile, SceneHandle
from condvln.trajectories.cameras import modality
from factory.machine import slowness
from factory.unit import InputFile, Unit
from jobs.configuration import load_config
from jobs.looker import datasets_of
from jobs.pipeline import BYTES_BASE, open_configured, scene_payload
from schemas.config import CameraConfig, Config, SourceConfig, TrajectoryConfig
from schemas.errors import InputError, MissingFileError, UsageError

__all__ = [
    "Estimate",
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
EDGE_BYTES: Final = {"rgb": 27.0, "depth": 65.0}
"""Expected bytes of an image file for each pixel of the edge of a square image of its size.

Means over ReplicaCAD, ProcTHOR and made scenes at 224 × 224 and 640 × 480: 20 to 35, and 38 to 92 for depth. A larger
image shows the same edges, so its size grows with its edge rather than with its area.
"""
STEPS_PER_METRE: Final = 6.0
"""Expected actions for each metre of a route, turns included."""
LEAST_STEPS: Final = 8.0
"""Expected actions of a walk of no length."""
LOOK_STEPS: Final = 25.0
"""Expected actions for looking at the evidence of one condition of the gold route, with the way there and back. Means
over made scenes of three families: 20 to 32.
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


@dataclass
class _Lines:
    """The manifest lines of one scene's episodes.

    metres, conditions : of the gold routes of all episodes together
    """

    numbers: list[int] = field(default_factory=list)
    size: int = 0
    metres: float = 0.0
    conditions: int = 0
    state: Any = field(default_factory=hashlib.sha256)


def _walks(kind: str, config: TrajectoryConfig) -> int:
    """Return the number of walks of a kind for each episode."""
    return config.recoveries if kind == "recovery" else 1


def _frames(kind: str, config: TrajectoryConfig, found: _Lines) -> float:
    """Return the expected number of frames of all walks of a kind in one scene."""
    episodes = len(found.numbers)
    frames = STEPS_PER_METRE * found.metres + LEAST_STEPS * episodes
    if kind == "recovery":
        # A mistake of mean length, and as many actions to undo it.
        frames += (config.least_mistake + config.most_mistake) * episodes
    elif kind == "exploration":
        frames += LOOK_STEPS * found.conditions
    return frames * _walks(kind, config)


def list_units(
    target: Target, cameras: Mapping[str, CameraConfig], config: TrajectoryConfig, hash_file: HashFile
) -> list[Unit]:
    """List the scenes of the split as units, with the walks of `config` as their expected cost.

    A scene that no source has, or that can't be listed, becomes a unit that holds its error.
    """
    manifest = manifest_path(target.export, target.split)
    lines: defaultdict[tuple[str, str], _Lines] = defaultdict(_Lines)
    for line in manifest_lines(manifest):
        fields = line.fields()
        found = lines[str(fields.get("source")), str(fields.get("scene_id"))]
        found.numbers.append(line.number)
        found.size += len(line.text)
        found.state.update(hashlib.sha256(line.text).digest())
        length = fields.get("route_length")
        found.metres += float(length) if isinstance(length, int | float) else 0.0
        evidence = fields.get("evidence")
        found.conditions += len(evidence) if isinstance(evidence, list) else 1
    handles = scene_handles(target, {scene for _, scene in lines}, hash_file)
    # An oracle walk has the images of the gold walk.
    kinds = sorted({"gold" if kind == "oracle" else kind for kind in config.walks})
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
                sum(_frames(kind, config, found) for kind in kinds),
                cameras,
                float(sum(_walks(kind, config) for kind in kinds) * len(found.numbers)),
            )
        )
    return units


def scene_unit(
    family: str,
    scene_id: str,
    handle: tuple[SourceConfig, SceneHandle] | None,
    inputs: Sequence[InputFile],
    payload: Mapping[str, Any],
    frames: float,
    cameras: Mapping[str, CameraConfig],
    walks: float = 0.0,
) -> Unit:
    """Return the unit of one scene; it holds an error if no source has the scene, or the scene can't be listed.

    inputs, payload : of the walks; those of the scene are added
    frames, walks : expected number of frames, and of walks that have to be found
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
        payload={**own, **payload},
        costs={"walks": 0.02 * walks, "frames": 1.0 + frames * pixels * PIXEL_SECONDS},
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

    frames : frames of all walks; images : files; gigabytes : of them; hours : CPU hours on this machine
    """

    scenes: int
    episodes: int
    frames: int
    images: int
    gigabytes: float
    hours: float


def estimate(units: Sequence[Unit], cameras: Mapping[str, CameraConfig]) -> Estimate:
    """Estimate a run from the lengths of the routes."""
    pixels = sum(camera.width * camera.height for camera in set(cameras.values()))
    frames = sum(max(unit.costs["frames"] - 1.0, 0.0) for unit in units) / (pixels * PIXEL_SECONDS)
    size = sum(math.sqrt(c.width * c.height) * EDGE_BYTES[modality(name)] for name, c in cameras.items())
    episodes = sum(count for unit in units if isinstance(count := unit.payload["episodes"], int))
    seconds = sum(unit.cost for unit in units) * slowness()
    return Estimate(
        len(units), episodes, round(frames), round(frames * len(cameras)), frames * size / 1e9, seconds / 3600
    )

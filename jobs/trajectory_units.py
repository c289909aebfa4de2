"""The units of ``condvln trajectories``: the scenes of a split, with their episodes and their source files. Those of
``--from-recipe`` are the scenes of a recipe, whose hashes the new images are compared with.
"""

from __future__ import annotations

import hashlib
import math
import shutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from condvln.export.contents import read_index
from condvln.formats.image_files import encoders
from condvln.manifest import ManifestLine, manifest_lines, manifest_path, manifest_paths
from condvln.sensors.textures import decoders
from condvln.sources.source import HashFile, SceneHandle
from condvln.trajectories.cameras import MAIN, modality
from condvln.trajectories.hub import SceneWalks
from condvln.trajectories.recipe import Recipe
from condvln.trajectories.uninavid import REDUCED
from factory.stage import InputFile, Unit
from jobs.agents import datasets_of
from jobs.configuration import load_config
from jobs.export_origin import config_of
from jobs.pipeline import BYTES_BASE, open_configured, scene_payload
from jobs.settings import export_folder
from schemas.canonical import digest
from schemas.config import CameraConfig, Config, SourceConfig, TrajectoryConfig
from schemas.errors import FormatError, InputError, MissingFileError, ProofError, UsageError
from schemas.tables import TRAJECTORY_TABLES

__all__ = [
    "Comparison",
    "Estimate",
    "Frames",
    "WalkedSplit",
    "encoder_lines",
    "estimate",
    "find_split",
    "list_units",
    "other_decoders",
    "plan_lines",
    "recipe_target",
    "recipe_units",
    "scene_files",
    "scene_handles",
    "scene_unit",
]


def recipe_target(recipe: Recipe, scenes: tuple[str, ...]) -> WalkedSplit:
    """Return the target of a recipe: the split of the recipe, and the datasets from which the scenes are read.

    scenes : ``FAMILY=FOLDER`` each
    """
    config = config_of(recipe.folder, datasets_of(scenes))
    return WalkedSplit(recipe.folder, recipe.record.split, (), config, {}, recipe.record.export_snapshot)


def recipe_units(recipe: Recipe, target: WalkedSplit, hash_file: HashFile) -> list[Unit]:
    """List the scenes of a recipe as units; a scene that no dataset has becomes a unit that holds its error."""
    scenes = recipe.scenes
    handles = scene_handles(target, {scene for _, scene in scenes}, hash_file)
    inputs = []
    for name in TRAJECTORY_TABLES:
        size, sha256 = hash_file(recipe.folder / f"{name}.parquet")
        inputs.append(InputFile(f"recipe/{name}", size, sha256))
    return [
        scene_unit(
            family,
            scene_id,
            handles.get((family, scene_id)),
            inputs,
            {"episodes": scene.episodes},
            Frames(scene.frames, scene.poses, scene.told, scene.squared / FILMED),
            recipe.record.cameras,
        )
        for (family, scene_id), scene in sorted(scenes.items())
    ]


def scene_files(unit: Unit) -> str:
    """Return a hash over the source files of a scene."""
    own = [file for file in unit.inputs if not file.path.startswith(("manifest/", "recipe/"))]
    return digest([[file.path, file.size, file.sha256] for file in own])


def encoder_lines(recipe: Recipe) -> list[str]:
    """Return a sentence for each kind of image that another encoder, or another version, writes here than wrote the
    recipe's, so that its files have other bytes, and for each kind of texture that another decoder reads here.
    """
    theirs, ours = recipe.record.encoders, encoders()
    kinds = sorted({name.partition(".")[0] for name in recipe.record.cameras})
    suffixes = {"rgb": "jpg", "depth": "png"}
    lines = [
        f"{theirs.get(suffix, 'An unnamed encoder')} wrote the {suffix} files of the recipe; "
        f"{ours[suffix]} writes them here: bytes may differ"
        for suffix in (suffixes[kind] for kind in reversed(kinds))
        if theirs.get(suffix) != ours[suffix]
    ]
    return lines + other_decoders(recipe.record.decoders, decoders())


def other_decoders(theirs: Mapping[str, str], ours: Mapping[str, str]) -> list[str]:
    """Return a sentence for each kind of texture that another decoder, or another version, reads here than read it when
    the images were made: the colours may differ.
    """
    return [
        f"Textures ({kind}): read by {theirs[kind]} when the images were made, by {ours[kind]} here; colours may differ"
        for kind in sorted(theirs.keys() & ours.keys())
        if theirs[kind] != ours[kind]
    ]


@dataclass
class Comparison:
    """Counts images that are, and are not, those of a recipe.

    scenes : scenes whose source files differ from those that the recipe was made with
    """

    recipe: Recipe
    same: int = 0
    different: int = 0
    first: str = ""
    scenes: list[str] = field(default_factory=list)

    def add(self, scene: SceneWalks) -> None:
        """Compare the images of a scene."""
        wanted = self.recipe.hashes(scene.source, scene.scene_id)
        poses = scene.tables["poses"]
        found = dict(zip(poses["image"].to_pylist(), poses["sha256"].to_pylist(), strict=True))
        for image in sorted(wanted.keys() | found.keys()):
            if wanted.get(image) == found.get(image):
                self.same += 1
            else:
                self.different += 1
                self.first = self.first or image

    def add_files(self, unit: Unit) -> None:
        """Compare the source files of a scene with those that the recipe was made from."""
        if self.recipe.record.scene_files.get(unit.unit_id, "") not in ("", scene_files(unit)):
            self.scenes.append(unit.unit_id)

    def document(self) -> dict[str, Any]:
        """Return the counts for scripts."""
        return {
            "images_of_the_recipe": self.same,
            "images_unlike_the_recipe": self.different,
            "scenes_unlike_the_recipe": sorted(self.scenes),
        }

    def lines(self, libraries: dict[str, str]) -> list[str]:
        """Return the result in words.

        libraries : versions of the libraries here
        """
        lines = [f"{self.same:,} of {self.same + self.different:,} images are those of the recipe, byte for byte"]
        if self.different:
            lines.append(f"The first image that differs: {self.first}")
        if self.scenes:
            shown = ", ".join(sorted(self.scenes)[:5])
            lines.append(f"Files of {len(self.scenes):,} scenes differ from those of the recipe: {shown}")
        theirs = self.recipe.record.libraries
        other = [
            f"{name} {theirs[name]} (here {libraries[name]})"
            for name in sorted(theirs.keys() & libraries)
            if theirs[name] != libraries[name]
        ]
        if other:
            lines.append(f"The recipe was made with {', '.join(other)}")
        return lines + encoder_lines(self.recipe)

    @property
    def exit_code(self) -> int:
        """The exit code of a run: the exit code of a failed proof if an image differs from the recipe, else 0."""
        return ProofError.exit_code if self.different else 0


PIXEL_SECONDS: Final = 5e-8
"""Expected CPU seconds of rendering and encoding one pixel."""
HEADER_BYTES: Final = {"rgb": 600.0, "depth": 0.0}
"""Bytes of an image file of any size: the tables of a JPEG."""
EDGE_BYTES: Final = {"rgb": 24.5, "depth": 65.0}
"""Expected further bytes of an image file for each pixel of the edge of a square image of its size.

Means of whole files over ReplicaCAD, ProcTHOR and made scenes at 224 × 224 and 640 × 480: 20 to 35, and 38 to 92 for
depth. A larger image shows the same edges, so its size grows with its edge rather than with its area. A small one has
about a byte a pixel at most.
"""
STEPS_PER_METRE: Final = 6.0
"""Expected actions for each metre of a route, turns included."""
MOST_METRES: Final = 1e5
"""Length of a route above which a manifest is taken for damaged. The longest routes of buildings have some hundred."""
LEAST_STEPS: Final = 8.0
"""Expected actions of a walk of no length."""
SHARED: Final = {"recovery": 0.65, "looking": 0.35}
"""Share of the direct walk's frames whose poses a walk of this kind repeats. Means over made scenes of three families:
0.60 to 0.72 and 0.31 to 0.42.
"""
FORKED: Final = 0.4
"""Share of a direct walk's frames whose poses another direct walk from the same start has, too, until the two part."""
FILMED: Final = 8.0
"""A walk of n frames has n² / `FILMED` frames in Uni-NaVid's videos: one video for every fourth frame, of all frames so
far.
"""


@dataclass(frozen=True)
class WalkedSplit:
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


def find_split(text: str, split: str, scenes: Sequence[str] = (), overrides: Sequence[str] = ()) -> WalkedSplit:
    """Return the target that the argument CONFIG|EXPORT names.

    scenes : ``FAMILY=FOLDER`` each, the datasets of an export

    Raises
    ------
    UsageError : it names neither, there is no such split, or no dataset is named
    """
    path = Path(text)
    if path.is_dir():
        export = path.resolve()
        config = config_of(export, datasets_of(scenes))
    else:
        config = load_config(path, overrides)
        export = export_folder(config, path)
    known = [found.stem for found in manifest_paths(export)]
    if split not in known:
        raise UsageError(
            f"there is no split {split!r}",
            where=export,
            remedy=f"Choose one of {', '.join(known)}." if known else "Name the folder that condvln export wrote.",
        )
    index = read_index(export) or {}
    texts = index.get("texts")
    return WalkedSplit(
        export,
        split,
        (export, *(source.root for source in config.sources)),
        config,
        texts if isinstance(texts, dict) else {},
        str(index.get("snapshot", "")),
    )


@dataclass(frozen=True)
class Frames:
    """Expected numbers of frames.

    own : of walks that have images of their own
    rendered : distinct poses among them; the images of a pose are rendered once
    told : of all walks; an oracle walk has the images of the direct walk
    filmed : of all videos in Uni-NaVid's layout
    """

    own: float = 0.0
    rendered: float = 0.0
    told: float = 0.0
    filmed: float = 0.0

    def __add__(self, other: Frames) -> Frames:
        return Frames(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


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
    """Return the kinds of walks that have images of their own: an oracle walk has those of the direct walk."""
    return sorted({"direct" if kind == "oracle" else kind for kind in config.walks})


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
    length, looking = fields.get("route_length"), fields.get("looking_actions")
    direct = STEPS_PER_METRE * metres + LEAST_STEPS
    frames = {
        # A mistake of mean length, and as many actions to undo it.
        "recovery": direct + config.least_mistake + config.most_mistake,
        "looking": float(len(looking)) if isinstance(looking, list) else 0.0,
    }
    start = repr([fields.get("start_position"), fields.get("start_rotation")])
    again, forked = f"{start} {length}" in routes, start in routes
    routes |= {start, f"{start} {length}"}
    kinds = _kinds(config)
    found = Frames()
    for kind in kinds:
        each, count = frames.get(kind, direct), _walks(kind, config)
        shared = SHARED.get(kind, 0.0) * direct if "direct" in kinds else 0.0
        # Episodes of one route have the same direct walk and the same evidence; each has mistakes of its own.
        rendered = each - shared if kind == "recovery" else 0.0 if again else each - shared - FORKED * direct * forked
        told = count * (2 if kind == "direct" and "oracle" in config.walks else 1)
        found += Frames(count * each, count * rendered, told * each, told * each**2 / FILMED)
    return found


def list_units(
    target: WalkedSplit, cameras: Mapping[str, CameraConfig], config: TrajectoryConfig, hash_file: HashFile
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
    target: WalkedSplit, wanted: set[str], hash_file: HashFile
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
        remedy="Name its dataset: in the configuration's 'sources', or with --data FAMILY=DIR.",
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
    seconds = sum(unit.cost for unit in units)
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
    pixels = camera.width * camera.height / reduced**2
    return HEADER_BYTES[kind] + min(math.sqrt(pixels) * EDGE_BYTES[kind], pixels)


def plan_lines(expected: Estimate, folder: Path) -> list[str]:
    """Return what a run is expected to make and to cost, and the free space of its disk."""
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(parent).free / 1e9
    lines = [
        f"{expected.episodes:,} episodes of {expected.scenes:,} scenes: about {expected.frames:,} frames, of which "
        f"{expected.rendered:,} are rendered and the others show the same poses; {expected.images:,} images, "
        f"{expected.gigabytes:.2f} GB, {expected.hours:.2f} CPU hours; {free:.1f} GB are free"
    ]
    if expected.gigabytes > free:
        lines.append(f"The disk of {folder} is too small for this.")
    return lines

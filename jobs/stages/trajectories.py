"""Stages ``walks`` and ``frames``: an export's episodes of one scene → walks → images and their poses."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import orjson
import pyarrow as pa

from condvln.formats.image_files import encoders
from condvln.manifest import manifest_lines
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.sensors import Renderer, open_renderer
from condvln.sensors.assembly import OWNERS_BY_BOX
from condvln.sensors.textures import decoders
from condvln.trajectories.images import ImageWriter
from condvln.trajectories.recipe import Recipe
from condvln.trajectories.walks import (
    LeftOut,
    WalkRows,
    direct_walk,
    looking_walk,
    recovery_walks,
    repeats_of,
    twin_of,
)
from factory.rows import logical_hash
from factory.stage import Stage, StageOutput, Unit
from jobs.oracle import twin_text
from jobs.stages.inputs import Tables, dump, source_of
from schemas.canonical import JSON, digest
from schemas.config import CameraConfig, LimitsConfig, TrajectoryConfig
from schemas.evaluation import ManifestEpisode

__all__ = ["NOTES", "NO_IMAGES", "STAMP", "FrameStage", "RecipeStage", "WalkStage", "stamp_path"]

STAMP: Final = "stamp"
"""File of a commit of ``frames`` that says which images it wrote; see `stamp_path`."""

NOTES: Final = "notes"
"""File of a commit of ``frames`` that holds a JSON list: how the images are known to deviate from real views."""

NO_IMAGES: Final = b"none"
"""Content of `STAMP` where the images were rendered and hashed, and not written."""

_IMAGE_KEYS: Final = frozenset({"goal_slack", "jpeg_quality", "png_level"})
"""Keys of the configuration that the images depend on, and the walks do not."""


def stamp_path(state: Path, unit_id: str) -> Path:
    """Return the file that says which commit the images of a unit belong to.

    It is written before the first image, so that a commit never vouches for images that another one overwrote.
    """
    return state / "written" / hashlib.sha256(unit_id.encode()).hexdigest()


@dataclass
class WalkStage(Stage):
    """Episodes of a split → walks with their poses.

    texts : how the export's texts were rendered, for the oracle-linear twin; None if it is not asked for
    """

    config: TrajectoryConfig
    texts: Mapping[str, Any] | None = None
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    name: str = "walks"
    version: int = 7
    tables: tuple[str, ...] = ("trajectories", "steps", "left_out")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        walks = {key: value for key, value in dump(self.config).items() if key not in _IMAGE_KEYS}
        return {"walks": walks, "texts": None if self.texts is None else dict(self.texts)}

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        navmeshes = _navmeshes(tuple(str(root) for root in _list(unit, "roots")))
        rows = WalkRows(str(unit.payload["scene_id"]))
        kinds = {*self.config.walks}
        scene = None
        if kinds != {"looking"}:
            scene = source_of(unit, self.limits).read(str(unit.payload["scene_id"]))
        for episode in _episodes(unit):
            pathfinder = navmeshes(episode)
            found = [looking_walk(episode, pathfinder, self.config)] if "looking" in kinds else []
            direct = None
            if scene is not None:
                goal = scene.object_of[episode.program.leaves[episode.gold_leaf].goal.object_id].center
                if kinds & {"direct", "oracle"}:
                    direct = direct_walk(episode, pathfinder, self.config, goal)
                    found.append(direct)
                if "recovery" in kinds:
                    found += recovery_walks(episode, pathfinder, self.config, goal)
            for walked in found:
                if isinstance(walked, LeftOut):
                    rows.leave_out(episode, walked)
                    continue
                repeats = repeats_of(walked, self.config)
                rows.add(episode, walked, pathfinder, episode.instruction_text, repeats)
            if "oracle" in kinds and direct is not None and not isinstance(direct, LeftOut):
                twin, repeats = twin_of(direct, episode), repeats_of(direct, self.config)
                rows.add(episode, twin, pathfinder, twin_text(episode, self.texts or {}), repeats, direct.name)
        tables = rows.tables()
        return StageOutput(tables=tables, measures={"frames": float(tables["steps"].num_rows)})


@dataclass
class RecipeStage(Stage):
    """A recipe → its walks with their poses, as `WalkStage` returns them.

    folder : the folder of the recipe; never keyed
    """

    folder: Path
    name: str = "walks"
    version: int = 2
    tables: tuple[str, ...] = ("trajectories", "steps", "left_out")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {"recipe": True}

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        tables = Recipe(self.folder).tables(unit.partition, str(unit.payload["scene_id"]))
        return StageOutput(tables=tables, measures={"frames": float(tables["steps"].num_rows)})


@dataclass
class FrameStage(Stage):
    """Poses → images below `folder`, and one row for each.

    folder : the folder of the trajectories; never keyed
    state : the folder of the run's own records; never keyed
    keep : write the images; otherwise they are only rendered and hashed
    """

    folder: Path
    state: Path
    cameras: Mapping[str, CameraConfig]
    config: TrajectoryConfig
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    keep: bool = True
    name: str = "frames"
    version: int = 5
    tables: tuple[str, ...] = ("poses",)
    reads: tuple[str, ...] | None = ("steps",)
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {
            "cameras": {name: dump(camera) for name, camera in self.cameras.items()},
            "images": {key: getattr(self.config, key) for key in sorted(_IMAGE_KEYS)},
            "encoders": dict(encoders()),
            "decoders": dict(decoders()),
            **({} if self.keep else {"keep": False}),
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        steps = upstream["steps"]
        stamp = self._stamped(unit, steps) if self.keep else NO_IMAGES
        renderer = self._renderer(unit)
        # There are no images of instances.
        notes = [note for note in renderer.notes if note != OWNERS_BY_BOX]
        writer = ImageWriter(self.folder, renderer, self.cameras, self.config, keep=self.keep)
        poses = writer.write(steps)
        return StageOutput(
            tables={"poses": poses},
            files={STAMP: stamp, NOTES: orjson.dumps(notes)},
            measures={"images": float(poses.num_rows), "image_bytes": float(writer.size)},
        )

    def _stamped(self, unit: Unit, steps: pa.Table) -> bytes:
        """Write and return the stamp of the images that are about to be written."""
        files: list[JSON] = [[file.path, file.size, file.sha256] for file in unit.inputs]
        stamp = digest([files, self.parameters(unit), self.version, logical_hash(steps)[0]])
        marker = stamp_path(self.state, unit.unit_id)
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.write_text(stamp)
        return stamp.encode()

    def _renderer(self, unit: Unit) -> Renderer:
        source = source_of(unit, self.limits)
        scene = source.read(str(unit.payload["scene_id"]))
        return open_renderer(scene, source.geometry(scene))


@lru_cache(maxsize=2)
def _navmeshes(roots: tuple[str, ...]) -> NavmeshFolder:
    return NavmeshFolder([Path(root) for root in roots])


def _list(unit: Unit, key: str) -> list[JSON]:
    found = unit.payload[key]
    assert isinstance(found, list)
    return found


def _episodes(unit: Unit) -> Iterator[ManifestEpisode]:
    """Yield the episodes of a unit, sorted by id."""
    path = Path(str(unit.payload["manifest"]))
    wanted = {int(str(number)) for number in _list(unit, "lines")}
    found = (line.row() for line in manifest_lines(path) if line.number in wanted)
    return iter(sorted(found, key=lambda row: row.episode_id))

"""``condvln verify --trajectories``: prove a folder of trajectories against its export, navmeshes and scenes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from condvln.manifest import manifest_path, read_manifest
from condvln.navigation.follower import ActionSpace
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.scene import Scene
from condvln.scene.scene import SceneGeometry
from condvln.sensors import Renderer, open_renderer
from condvln.sensors.textures import decoders
from condvln.trajectories.hub import Hub, SceneWalks
from condvln.verify.trajectories import TrajectoryWorld, prove_trajectories
from jobs.oracle import twin_text
from jobs.pipeline import SceneReader
from jobs.report import Report
from jobs.trajectories import WRITERS
from jobs.trajectory_units import WalkedSplit, other_decoders
from schemas.config import CameraConfig
from schemas.errors import ProofError
from schemas.evaluation import ManifestEpisode

__all__ = ["RENDER_EVERY", "trajectory_world", "verify_trajectories", "write_layout"]

RENDER_EVERY: Final = 50
"""Of how many images one is rendered again."""
KEPT: Final = 2
"""Number of scenes, and renderers that stay in memory."""
SHOWN: Final = 20
"""Number of faults shown on a terminal; --json has all of them."""


def verify_trajectories(target: WalkedSplit, folder: Path, *, render_every: int = RENDER_EVERY) -> Report:
    """Check every walk, pose and image of a folder, and render some images again.

    Raises
    ------
    MissingFileError, FormatError : the folder holds no trajectories, or a file of it or of the export is damaged
    """
    proof = prove_trajectories(folder, trajectory_world(target, render_every))
    lines = [
        f"{proof.walks:,} walks, {proof.frames:,} frames, {proof.images:,} images read, {proof.rendered:,} rendered "
        f"again: {len(proof.faults):,} faults"
    ]
    lines += [f"{name}: {count:,} rows compared with the images and poses" for name, count in proof.layout_rows.items()]
    lines += [
        f"{name}: the words of {count:,} walks replayed as the agent means them"
        for name, count in proof.layout_walks.items()
    ]
    lines += other_decoders(proof.decoders, decoders())
    lines += [str(fault) for fault in proof.faults[:SHOWN]]
    if len(proof.faults) > SHOWN:
        lines.append(f"… and {len(proof.faults) - SHOWN:,} more, see --json")
    return Report(asdict(proof), lines, exit_code=ProofError.exit_code if proof.faults or not proof.walks else 0)


def trajectory_world(target: WalkedSplit, render_every: int = RENDER_EVERY) -> TrajectoryWorld:
    """Return the episodes, texts, navmeshes and renderers with which the walks of a target's split are compared."""
    episodes = {int(row.episode_id): row for row in read_manifest(manifest_path(target.export, target.split))}

    def text(episode: ManifestEpisode, kind: str) -> str:
        return twin_text(episode, target.texts) if kind == "oracle" else episode.instruction_text

    reader, navmeshes = SceneReader(target.config), NavmeshFolder(target.roots)

    @lru_cache(maxsize=KEPT)
    def read(family: str, scene_id: str) -> tuple[Scene, SceneGeometry | None]:
        source, scene = reader.read(family, scene_id)
        return scene, source.geometry(scene)

    @lru_cache(maxsize=KEPT)
    def renderer(family: str, scene_id: str) -> Renderer:
        return open_renderer(*read(family, scene_id))

    return TrajectoryWorld(
        episodes,
        text,
        navmeshes,
        lambda episode: renderer(episode.source, episode.scene_id),
        write_layout,
        render_every,
    )


def write_layout(
    name: str, folder: Path, record: Mapping[str, Any], scenes: Iterable[tuple[str, str, Mapping[str, pa.Table]]]
) -> None:
    """Write a layout below a folder that has the images.

    record : content of ``trajectories.json``
    scenes : source, id and tables of each scene
    """
    cameras = {camera: CameraConfig(**values) for camera, values in record["cameras"].items()}
    space = ActionSpace(record["config"]["forward"], record["config"]["turn"])
    with WRITERS[name](Hub(folder, record["split"], cameras, space)) as add:
        for scene in scenes:
            add(SceneWalks(*scene))

"""``condvln verify --trajectories``: prove a folder of trajectories against its export, navmeshes and scenes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from condvln.manifest import manifest_path, read_manifest
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.scene.geometry import SceneGeometry
from condvln.sensors import Renderer, open_renderer
from condvln.sensors.textures import decoders
from condvln.sources.source import Source, hash_file
from condvln.verify.exploration import Onlooker
from condvln.verify.trajectories import TrajectoryWorld, prove_trajectories
from jobs.oracle import linear_text
from jobs.pipeline import open_configured
from jobs.report import Report
from jobs.trajectory_recipe import other_decoders
from jobs.trajectory_units import Target
from schemas.config import WordingConfig
from schemas.errors import MissingFileError, ProofError
from schemas.evaluation import ManifestEpisode

__all__ = ["RENDER_EVERY", "trajectory_world", "verify_trajectories"]

RENDER_EVERY: Final = 50
"""Of how many images one is rendered again."""
SHOWN: Final = 20
"""Number of faults shown on a terminal; --json has all of them."""


def verify_trajectories(target: Target, folder: Path, *, render_every: int = RENDER_EVERY) -> Report:
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
    if proof.looked_for:
        lines.append(f"{proof.looked_for:,} conditions of exploration walks: their evidence was looked for again")
    lines += [f"{name}: {count:,} rows compared with the images and poses" for name, count in proof.layout_rows.items()]
    lines += other_decoders(proof.decoders, decoders())
    lines += [str(fault) for fault in proof.faults[:SHOWN]]
    if len(proof.faults) > SHOWN:
        lines.append(f"… and {len(proof.faults) - SHOWN:,} more, see --json")
    return Report(asdict(proof), lines, exit_code=ProofError.exit_code if proof.faults or not proof.walks else 0)


def trajectory_world(target: Target, render_every: int = RENDER_EVERY) -> TrajectoryWorld:
    """Return the episodes, texts, navmeshes and renderers with which the walks of a target's split are compared."""
    episodes = {int(row.episode_id): row for row in read_manifest(manifest_path(target.export, target.split))}
    texts: Mapping[str, Any] = target.texts
    wording = WordingConfig.model_validate({k: v for k, v in texts.items() if k in WordingConfig.model_fields})

    def text(episode: ManifestEpisode, kind: str) -> str:
        if kind != "oracle":
            return episode.instruction_text
        y, w = episode.start_rotation[1], episode.start_rotation[3]
        return linear_text(
            episode.program,
            episode.instruction_id,
            -math.degrees(2 * math.atan2(y, w)) % 360.0,
            wording,
            seed=int(texts.get("seed", 0)),
            preamble=bool(texts.get("preamble", True)),
        )

    scenes, navmeshes = _Scenes(target), NavmeshFolder(target.roots)

    @lru_cache(maxsize=2)
    def onlooker(source: str, scene_id: str, navmesh: Pathfinder) -> Onlooker:
        return Onlooker(*scenes.read(source, scene_id), navmesh)

    return TrajectoryWorld(
        episodes,
        text,
        navmeshes,
        scenes.renderer,
        lambda episode: onlooker(episode.source, episode.scene_id, navmeshes(episode)),
        render_every,
    )


class _Scenes:
    """Reads scenes and their surfaces, and opens their renderers; the latest ones stay in memory."""

    _KEPT: Final = 2

    def __init__(self, target: Target) -> None:
        self._target = target
        self._sources: dict[str, list[Source]] = {}
        for source in target.config.sources:
            opened = open_configured(target.config, source, hash_file)
            self._sources.setdefault(source.family, []).append(opened)
        self.read = lru_cache(maxsize=self._KEPT)(self._read)
        self._renderer = lru_cache(maxsize=self._KEPT)(lambda *name: open_renderer(*self.read(*name)))

    def renderer(self, episode: ManifestEpisode) -> Renderer:
        """Return the renderer of an episode's scene."""
        return self._renderer(episode.source, episode.scene_id)

    def _read(self, family: str, scene_id: str) -> tuple[Scene, SceneGeometry | None]:
        missing = MissingFileError("no source has this scene", where=f"{family}/{scene_id}")
        for source in self._sources.get(family, ()):
            try:
                scene = source.read(scene_id)
                return scene, source.geometry(scene)
            except MissingFileError as error:
                missing = error
        raise missing

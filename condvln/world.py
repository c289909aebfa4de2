"""One scene in memory: its objects, where an agent can walk, and the episodes that a run would generate for it.

The steps are those of a run (``condvln generate``) without a store: relations, candidate programs, placing, text.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import networkx as nx
import numpy as np
import numpy.typing as npt

from condvln.episodes.picture import draw_episode, wall_lines
from condvln.episodes.pool import EpisodePool
from condvln.episodes.steps import ProgramSettings, Walkable, look_around, place_programs, published_texts
from condvln.episodes.table import placements_table, with_text
from condvln.episodes.view import SceneView
from condvln.episodes.visibility import sightings_from_table, visibility_table
from condvln.export.tables import rows_of
from condvln.instructions import (
    LabelPriors,
    instruction_table,
)
from condvln.instructions.programs import program_tree
from condvln.instructions.referents import Referents
from condvln.labels import vocabulary
from condvln.manifest import manifest_row, published_row
from condvln.navigation.navmesh_file import parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_built_navmesh, with_shipped_navmesh
from condvln.navigation.sight import Recognition
from condvln.relations import RoomRelations, TextFacts, relate_scene, text_facts, to_networkx
from condvln.scene import Scene
from condvln.scene.meshes import MeshLibrary
from condvln.scene.scene import SceneGeometry
from condvln.sensors import Frame, Renderer, cameras_of, open_renderer
from condvln.sensors.shading import shaded
from condvln.sources.scene_source import Source
from schemas.config import (
    AgentConfig,
    CameraConfig,
    EpisodeConfig,
    GoalsConfig,
    InstructionsConfig,
    PlacesConfig,
    SamplingConfig,
    TextConfig,
    Thresholds,
    WordingConfig,
)
from schemas.errors import InputError
from schemas.evaluation import ManifestEpisode
from schemas.program import Program

__all__ = ["World", "label_priors", "open_world"]

FIRST_VIEW: Final = "streamvln"
"""Cameras by which first views are drawn."""


@dataclass(frozen=True, eq=False)
class World:
    """A scene with the navmesh that was chosen or built for an agent; made by :func:`open_world`.

    Attributes
    ----------
    scene : rooms and objects, Habitat frame, metres
    geometry : the scene's surfaces; None if its dataset has none
    agent : the agent that the navmesh is for
    navmesh_data : bytes of the navmesh if it was built here; None if the dataset ships it
    """

    scene: Scene
    geometry: SceneGeometry | None
    agent: AgentConfig
    navmesh_data: bytes | None = None

    def __repr__(self) -> str:
        scene = self.scene
        navmesh = "no navmesh" if scene.navmesh is None else scene.navmesh.path
        return (
            f"World({scene.family}/{scene.scene_id}: {len(scene.rooms)} rooms, {len(scene.objects)} objects, {navmesh})"
        )

    @cached_property
    def pathfinder(self) -> Pathfinder:
        """The pathfinder of the scene's navmesh, with habitat-sim's method names and results.

        Raises
        ------
        InputError : the scene has no navmesh, and neither mesh nor walls to build one from
        """
        navmesh = self.scene.navmesh
        if navmesh is None:
            raise InputError(
                "the scene has no navmesh, and neither mesh nor walls to build one from",
                where=f"{self.scene.family}/{self.scene.scene_id}",
                remedy="Put the dataset's navmesh or mesh beside the scene",
            )
        if self.navmesh_data is not None:
            return Pathfinder(parse_navmesh(self.navmesh_data, navmesh.path))
        return Pathfinder.load(self.scene.root / navmesh.path)

    @cached_property
    def view(self) -> SceneView:
        """The scene's occluders and objects, for line-of-sight tests."""
        return SceneView(self.scene, self.geometry)

    @cached_property
    def renderer(self) -> Renderer:
        """The scene's renderer; see `open_renderer`.

        Raises
        ------
        InputError : a mesh can't be read
        """
        return open_renderer(self.scene, self.geometry)

    def look(self, position: npt.ArrayLike, heading: float = 0.0, camera: CameraConfig | None = None) -> Frame:
        """Return what a camera sees. The agent is at a position (3,) in metres, with a heading in radians
        counter-clockwise from −Z.

        camera : VLN-CE's depth camera if None

        Raises
        ------
        InputError : a mesh can't be read
        """
        return self.renderer.look(camera or CameraConfig(), position, heading)

    def relations(self, thresholds: Thresholds | None = None) -> dict[str, RoomRelations]:
        """Return distances, directions and predicates of all ordered pairs of objects, by room id."""
        return relate_scene(self.scene, thresholds or Thresholds(), MeshLibrary(self.scene.root).world_mesh)

    def relation_graph(self, thresholds: Thresholds | None = None) -> nx.MultiDiGraph[str]:
        """Return the relation graph: nodes are rooms and objects, edges are predicates; see `to_networkx`."""
        thresholds = thresholds or Thresholds()
        return to_networkx(self.scene, self.relations(thresholds), thresholds)

    def referents(
        self, thresholds: Thresholds | None = None, sampling: SamplingConfig | None = None
    ) -> dict[str, Referents]:
        """Return, by room id, the phrases that identify each object: the object's label if it is unique in the room,
        else the label with a qualifier.
        """
        anchor_size = (sampling or SamplingConfig()).anchor_size
        facts = self._facts(thresholds or Thresholds())
        return {
            room.room_id: Referents.of(
                room, self.scene.arrays(room.room_id), facts[room.room_id], vocabulary, anchor_size
            )
            for room in self.scene.rooms
        }

    def episodes(
        self,
        *,
        instructions: InstructionsConfig | None = None,
        priors: LabelPriors | None = None,
        thresholds: Thresholds | None = None,
        sampling: SamplingConfig | None = None,
        places: PlacesConfig | None = None,
        goals: GoalsConfig | None = None,
        episodes: EpisodeConfig | None = None,
        text: TextConfig | None = None,
        seed: int = 0,
    ) -> list[ManifestEpisode]:
        """Return the episodes that a run would generate for this scene, in the order in which they were placed.

        Parameters
        ----------
        instructions : how many episodes of each category
        priors : which labels are usual in which rooms, see :func:`label_priors`; if None, counted on this scene alone,
            which is little data: a run pools all scenes

        Raises
        ------
        InputError : the scene has no navmesh
        """
        instructions, sampling = instructions or InstructionsConfig(), sampling or SamplingConfig()
        places, goals, episodes = places or PlacesConfig(), goals or GoalsConfig(), episodes or EpisodeConfig()
        text, thresholds = text or TextConfig(), thresholds or Thresholds()
        scene = self.scene
        priors = priors or label_priors([scene], thresholds=thresholds, sampling=sampling, places=places)
        walkable = Walkable(self.pathfinder, self.view, self.agent.max_climb)
        seen = look_around(scene, walkable, places, Recognition.of(places, episodes))
        sightings = sightings_from_table(visibility_table(scene, seen))
        placed = place_programs(
            scene,
            self._facts(thresholds),
            priors.bits(
                scene,
                sampling.plausible_share,
                sampling.predicates,
                instructions.directions,
                sampling.label_only(scene.single_room),
                places,
            ),
            walkable,
            sightings,
            ProgramSettings(thresholds, places, instructions, sampling, goals, episodes, text.preamble, seed),
        )
        return self._published(placed.pool, episodes, text, instructions.wording, seed)

    def draw(self, episode: ManifestEpisode, path: str | os.PathLike[str]) -> Path:
        """Write a PNG of an episode and return its path. The picture shows the plan from above, what the conditions ask
        about, the path to every leaf, the first view and a legend.
        """
        return self.draw_row(published_row(episode), episode.program, Path(path))

    def draw_row(self, row: Mapping[str, Any], program: Program, path: Path) -> Path:
        """Draw, as `draw` does, an episode that is a row of the table ``episodes`` as plain Python values."""
        floor, walls = self.pathfinder.navmesh.tile.outlines(), wall_lines(self.scene, self.geometry)
        tree, view = program_tree(program), self.first_view(row)
        draw_episode(path, self.scene, floor, row, tree, program=program, walls=walls, view=view)
        return path

    def first_view(self, row: Mapping[str, Any]) -> npt.NDArray[np.uint8]:
        """Return what an agent sees at the start of an episode (h, w, 3), shaded where nothing has a texture.

        row : the row of the table ``episodes`` as plain Python values
        """
        start = row["start_position"]
        position = np.array([start["x"], start["y"], start["z"]], np.float64)
        camera = next(camera for name, camera in cameras_of(FIRST_VIEW).items() if name.startswith("rgb"))
        seen = self.renderer.look(camera, position, -math.radians(row["start_heading_degrees"]))
        return shaded(seen, self.renderer.labels, camera.hfov)

    def _facts(self, thresholds: Thresholds) -> Mapping[str, TextFacts]:
        return {room_id: text_facts(found, thresholds) for room_id, found in self.relations(thresholds).items()}

    def _published(
        self,
        pool: EpisodePool,
        rules: EpisodeConfig,
        text: TextConfig,
        wording: WordingConfig,
        seed: int,
    ) -> list[ManifestEpisode]:
        scene = self.scene
        assert scene.navmesh is not None
        programs = {episode.instruction_id: episode.program for episode in pool.episodes}
        placements = placements_table(scene, pool, scene.navmesh.sha256)
        _, texts = published_texts(programs, placements.to_pylist(), text, wording, seed)
        instruction_of = {
            row["instruction_id"]: row for row in rows_of(instruction_table(scene.scene_id, programs.items()))
        }
        names = {"source": scene.family, "split": "train", "navmesh": scene.navmesh.path, "snapshot": ""}
        return [
            ManifestEpisode.model_validate(manifest_row(row, instruction_of[row["instruction_id"]], **names))
            for row in rows_of(with_text(placements, texts, rules.max_steps, text.steps_per_word))
        ]


def open_world(source: Source, scene_id: str, agent: AgentConfig | None = None) -> World:
    """Open a scene with a navmesh: a shipped navmesh that fits the agent, else another shipped navmesh, else a navmesh
    that is built now.

    Raises
    ------
    InputError : the scene can't be read
    """
    agent = agent or AgentConfig()
    scene = with_shipped_navmesh(source.read(scene_id), agent)
    geometry = source.geometry(scene)
    data: bytes | None = None
    if scene.navmesh is None and geometry is not None:
        scene, data = with_built_navmesh(scene, geometry, agent)
    return World(scene, geometry, agent, data)


def label_priors(
    scenes: Iterable[Scene],
    *,
    thresholds: Thresholds | None = None,
    sampling: SamplingConfig | None = None,
    directions: str = "compass",
    places: PlacesConfig | None = None,
) -> LabelPriors:
    """Count over scenes which labels are usual in which room types, and how often statements about such rooms are
    true.
    """
    thresholds, sampling = thresholds or Thresholds(), sampling or SamplingConfig()
    counts = (
        (one.family, LabelPriors.of_scene(one, thresholds, sampling.anchor_size, usual_places=sampling.usual_places))
        for one in scenes
    )
    return LabelPriors.of_corpus(counts, sampling, directions, places or PlacesConfig())

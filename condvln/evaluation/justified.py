"""Whether a walk was justified: when the evidence of an episode's conditions was recognisable in the agent's own view.

It is asked of any walk, with the scene's surfaces and the rules of the looking paths; no file says what an agent saw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Final

from condvln.episodes.goals import blocked_footprints
from condvln.episodes.looking import LookingPaths
from condvln.episodes.observability import Observer
from condvln.episodes.steps import Walkable, look_around
from condvln.episodes.view import SceneView
from condvln.episodes.visibility import sightings_from_table, visibility_table
from condvln.evaluation.score import Sees
from condvln.evaluation.task import Task
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import Recognition
from condvln.sources.scene_source import Source
from schemas.config import AgentConfig, EpisodeConfig, PlacesConfig
from schemas.errors import MissingFileError

__all__ = ["EvidenceSeen"]

SCENES_KEPT: Final = 4
"""Number of scenes kept open."""


class EvidenceSeen:
    """Says what is recognised on walks in the scenes of some datasets.

    Parameters
    ----------
    sources : the dataset of each family
    places, rules, agent : those of the export's configuration
    """

    def __init__(
        self,
        sources: Mapping[str, Source],
        pathfinder_of: Callable[[Task], Pathfinder],
        places: PlacesConfig,
        rules: EpisodeConfig,
        agent: AgentConfig,
    ) -> None:
        self._sources, self._pathfinder_of = sources, pathfinder_of
        self._places, self._rules, self._climb = places, rules, agent.max_climb
        self._opened = lru_cache(maxsize=SCENES_KEPT)(self._open)

    def __call__(self, task: Task) -> Sees | None:
        """Return what is recognised on walks of a task; None where its scene is not there.

        Raises
        ------
        InputError : the scene can't be read
        """
        name = str(task.axes["scene"])
        if name.partition("/")[0] not in self._sources:
            return None
        with suppress(MissingFileError):
            looking = self._opened(name, self._pathfinder_of(task))
            return lambda walked: looking.decided(task.program, walked.positions, walked.headings)
        return None

    def _open(self, name: str, pathfinder: Pathfinder) -> LookingPaths:
        family, _, scene_id = name.partition("/")
        source = self._sources[family]
        scene = source.read(scene_id)
        view = SceneView(scene, source.geometry(scene))
        walkable = Walkable(pathfinder, view, self._climb)
        seen = look_around(scene, walkable, self._places, Recognition.of(self._places, self._rules))
        sightings = sightings_from_table(visibility_table(scene, seen))
        obstacles = blocked_footprints(scene, pathfinder, self._climb)
        observer = Observer(scene, view, pathfinder, self._places, self._rules, obstacles, sightings=sightings)
        return LookingPaths(scene, view, pathfinder, self._places, self._rules, observer)

"""Prove that an exploration walk has seen the evidence before it decides, with all rays cast again.

What counts as the evidence of a condition is what `condvln.verify.observability` says of an episode: a witness and its
anchor; or, for a false condition, all things that its words could mean and the anchor, or almost the whole floor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.scene import Scene
from condvln.scene.geometry import SceneGeometry
from condvln.verify.ground_points import ground_points
from condvln.verify.observability import proofs_of
from condvln.verify.referents import SceneReferents
from condvln.verify.rules import VerifierRules
from condvln.verify.sight import Sight
from condvln.verify.surfaces import Shapes
from schemas.evaluation import ManifestEpisode

__all__ = ["Onlooker"]

F64 = NDArray[np.float64]


class Onlooker:
    """Says which conditions an agent can judge after a walk in one scene.

    Parameters
    ----------
    geometry : the scene's surfaces, None if its dataset has none
    rules : range of sight, height of the eyes, and shares of the evidence that must be seen
    """

    def __init__(
        self,
        scene: Scene,
        geometry: SceneGeometry | None,
        pathfinder: Pathfinder,
        rules: VerifierRules | None = None,
    ) -> None:
        rules = rules or VerifierRules()
        self._places = rules.places
        self._referents = SceneReferents(scene, rules.thresholds, rules.anchor_size, Shapes(scene.root))

        def floor(room_id: str) -> F64:
            return ground_points(scene, scene.room_of[room_id], pathfinder, rules.places.island_radius, [])

        labels = self._referents
        self._sight = Sight(scene, geometry, labels.is_structure, labels.is_frame, floor, rules.places, rules.episodes)

    def unseen(self, episode: ManifestEpisode, places: F64, headings: F64, angle: float) -> list[int]:
        """Return the conditions of the gold route whose evidence was not seen at the given poses.

        places : (n, 3) of the agent's feet, metres; headings : (n,) radians counter-clockwise from −z
        angle : horizontal angle ahead of the agent within which it sees, degrees
        """
        eyes = eyes_at(places, self._places.eye_height)
        return [
            number
            for number in dict.fromkeys(episode.program.route()[0])
            if not any(
                all(self._sight.is_faced(thing, eyes, headings, angle) for thing in way)
                for way in proofs_of(episode.program.conditions[number], self._referents)
            )
        ]

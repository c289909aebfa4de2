"""The steps from a scene to its episodes, called by the stages of a run and by :class:`condvln.world.World`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.candidates import Candidate, draw_candidates
from condvln.episodes.goals import blocked_footprints, scene_goals, wide_islands
from condvln.episodes.graph_placing import GraphPlacer, NotOnGraph, viewpoint_stops
from condvln.episodes.observability import Observer
from condvln.episodes.placing import Placer, reachable_stops
from condvln.episodes.pool import EpisodePool, fill_pool
from condvln.episodes.routes import GoalField
from condvln.episodes.view import SceneView
from condvln.episodes.visibility import Visibility, scene_visibility
from condvln.instructions import (
    PriorBits,
    ProgramSampler,
    Stops,
    apart_by_centres,
    names_compass,
    render,
    with_preamble,
)
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.navigation.pathfinder import Pathfinder
from condvln.relations import TextFacts
from condvln.scene import Scene
from condvln.scene.sightings import Sightings
from schemas.config import (
    EpisodeConfig,
    GoalsConfig,
    InstructionCell,
    InstructionsConfig,
    PlacesConfig,
    SamplingConfig,
    TextConfig,
    Thresholds,
    WordingConfig,
)
from schemas.program import Program

__all__ = ["DrawnPrograms", "Walkable", "draw_programs", "look_around", "place_programs", "published_texts"]


@dataclass(frozen=True, eq=False, slots=True)
class Walkable:
    """Where an agent can walk in a scene and what it can see from there. `max_climb` is the height in metres of the
    largest step that it can climb.
    """

    pathfinder: Pathfinder
    view: SceneView
    max_climb: float


@dataclass(frozen=True, eq=False, slots=True)
class DrawnPrograms:
    """Candidate programs in the order in which placing tries them.

    goals : goal points (k, 3) by object id, of the objects that text can name; empty without a navmesh
    rejections : number of failed draws by cell and reason
    """

    goals: Mapping[str, NDArray[np.float64]]
    candidates: list[Candidate]
    rejections: Counter[tuple[InstructionCell | None, str]]


def look_around(scene: Scene, walkable: Walkable, *, eye_height: float, island_radius: float) -> list[Visibility]:
    """Return the visibility of every object that is not part of the building, from the positions in its room at which
    an agent can stand. `eye_height` and `island_radius` are in metres.
    """
    islands = wide_islands(walkable.pathfinder, PlacesConfig(island_radius=island_radius))
    obstacles = blocked_footprints(scene, walkable.pathfinder, walkable.max_climb)
    return list(scene_visibility(scene, walkable.view, walkable.pathfinder, islands, eye_height, obstacles))


def draw_programs(
    scene: Scene,
    facts: Mapping[str, TextFacts],
    bits: PriorBits,
    walkable: Walkable | None,
    sightings: Sightings,
    *,
    instructions: InstructionsConfig,
    sampling: SamplingConfig,
    places: PlacesConfig,
    goals: GoalsConfig,
    preamble: bool,
    seed: int,
    graph: GraphPathfinder | None = None,
) -> DrawnPrograms:
    """Draw the candidate programs of a scene.

    Without ``walkable`` and ``graph``, the distance between objects is that of their centres.

    Parameters
    ----------
    facts : what text may state about pairs of objects, by room id
    graph : viewpoint graph of a scan without a navmesh
    """
    goal_points: dict[str, NDArray[np.float64]] = {}
    placer: GraphPlacer | None = None
    # Samplers by what defines the distance between objects; each fills the cells that the previous ones left short.
    ways: list[Stops | Callable[[frozenset[str]], Stops]] = [apart_by_centres(scene, places)]
    if walkable is not None:

        def reachable(named: frozenset[str]) -> Stops:
            pathfinder = walkable.pathfinder
            obstacles = blocked_footprints(scene, pathfinder, walkable.max_climb)
            goal_points.update(scene_goals(scene, pathfinder, places, goals, obstacles, walkable.view, named))
            separation = places.leaf_separation(scene.single_room)
            return reachable_stops(pathfinder, GoalField(pathfinder, goal_points), separation)

        ways = [reachable]
    elif graph is not None:
        # If too few objects have a viewpoint, some instructions are published without episodes.
        ways.insert(0, viewpoint_stops(scene, graph))
        placer = GraphPlacer(scene, graph, seed)
    # Leaves are checked before one of them is drawn as gold, so that the check can't favour a truth.
    candidates: list[Candidate] = []
    rejections: Counter[tuple[InstructionCell | None, str]] = Counter()
    for stops in ways:
        sampler = ProgramSampler(
            scene,
            facts,
            bits,
            instructions,
            sampling,
            seed,
            stops=stops,
            preamble=preamble,
            placed=walkable is not None,
            sightings=sightings,
        )
        drawn = draw_candidates(sampler)
        rejections += sampler.rejections
        if placer is not None and stops is ways[0]:
            drawn, refused = _placeable(drawn, placer)
            rejections += refused
        candidates = _filled(candidates, drawn) if candidates else drawn
    return DrawnPrograms(goal_points, candidates, rejections)


def _placeable(
    candidates: list[Candidate], placer: GraphPlacer
) -> tuple[list[Candidate], Counter[tuple[InstructionCell | None, str]]]:
    """Return the candidates that can be placed on the viewpoints, and the numbers of rejections by cell and reason.
    Counterfactual groups are kept or dropped whole.

    Every leaf is checked as if it were gold, so that the selection is independent of the truth.
    """
    refused: Counter[tuple[InstructionCell | None, str]] = Counter()
    lost: set[str] = set()
    groups: set[str | None] = set()
    for candidate in candidates:
        try:
            placer.place(candidate.program, candidate.instruction_id, compass=False)
        except NotOnGraph as reason:
            refused[candidate.cell, str(reason)] += 1
            lost.add(candidate.instruction_id)
            groups.add(candidate.group_id)
    groups.discard(None)
    kept = [one for one in candidates if one.instruction_id not in lost and one.group_id not in groups]
    return kept, refused


def _filled(candidates: list[Candidate], others: list[Candidate]) -> list[Candidate]:
    """Return `candidates`, with some of `others` added in the cells that have fewer candidates than wanted.

    At most one other is added per two candidates, so that most published instructions have an episode.
    """
    there = {candidate.instruction_id for candidate in candidates}
    held = Counter(candidate.cell for candidate in candidates)
    added: list[Candidate] = []
    for other in others:
        if other.cell is None or other.instruction_id in there or held[other.cell] >= other.cell.count:
            continue
        held[other.cell] += 1
        added.append(other)
    return candidates + added[: len(candidates) // 2]


def place_programs(
    scene: Scene,
    candidates: Iterable[Candidate],
    goals: Mapping[str, NDArray[np.float64]],
    walkable: Walkable,
    sightings: Sightings,
    *,
    instructions: InstructionsConfig,
    sampling: SamplingConfig,
    places: PlacesConfig,
    rules: EpisodeConfig,
    thresholds: Thresholds,
    preamble: bool,
    seed: int,
) -> EpisodePool:
    """Place the candidates and return the episodes and the rejections."""
    placer = Placer(
        scene,
        walkable.pathfinder,
        goals,
        places,
        rules,
        seed,
        max_climb=walkable.max_climb,
        thresholds=thresholds,
        sightings=sightings,
    )
    observer = Observer(scene, walkable.view, walkable.pathfinder, places, rules, placer.obstacles, sightings=sightings)
    pool = fill_pool(
        candidates,
        placer,
        instructions.wanted,
        instructions.label_cap,
        lambda program: preamble and names_compass(program),
        observer,
        instructions.counterfactual_groups,
        sampling.move_shares,
    )
    pool.reject_collisions(scene.scene_id)
    return pool


def published_texts(
    programs: Mapping[str, Program],
    placements: Sequence[Mapping[str, Any]],
    text: TextConfig,
    wording: WordingConfig,
    seed: int,
) -> tuple[dict[str, str], dict[int, str]]:
    """Return two mappings: the text of each program by instruction id, and the text of each episode by episode id. The
    text of an episode may begin with a sentence that states the start heading.

    placements : rows of PLACEMENTS
    """
    bodies = {name: render(program, seed, name, wording) for name, program in programs.items()}
    texts: dict[int, str] = {}
    for row in placements:
        name = row["instruction_id"]
        said = bodies[name]
        if text.preamble and names_compass(programs[name]):
            said = with_preamble(said, row["start_heading_degrees"], seed, name, wording)
        texts[row["episode_id"]] = said
    return bodies, texts

"""The steps from a scene to its episodes, called by the stages of a run and by :class:`condvln.world.World`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from condvln.episodes.candidates import Candidate, CandidateSupply, draw_candidates
from condvln.episodes.goals import blocked_footprints, scene_goals, wide_islands
from condvln.episodes.graph_placing import GraphPlacer, NotOnGraph, viewpoint_stops
from condvln.episodes.leads import LeadPlaces
from condvln.episodes.looking import LookingPaths
from condvln.episodes.observability import Observer
from condvln.episodes.placing import Placer, reachable_stops
from condvln.episodes.pool import EpisodePool, fill_pool
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
from condvln.navigation.sight import Recognition
from condvln.relations import TextFacts
from condvln.scene import Scene
from condvln.scene.scene import Sightings
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

__all__ = [
    "DrawnPrograms",
    "PlacedPrograms",
    "ProgramSettings",
    "Walkable",
    "draw_programs",
    "look_around",
    "place_programs",
    "published_texts",
]


Rejections: TypeAlias = Counter[tuple[InstructionCell | None, str]]


@dataclass(frozen=True, eq=False, slots=True)
class ProgramSettings:
    """What the drawing and placing of programs follows: sections of the configuration, whether texts may name the start
    heading, and the seed.
    """

    thresholds: Thresholds
    places: PlacesConfig
    instructions: InstructionsConfig
    sampling: SamplingConfig
    goals: GoalsConfig
    episodes: EpisodeConfig
    preamble: bool
    seed: int


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
    """Candidate programs of a scene in which none is placed.

    rejections : number of failed draws by cell and reason
    """

    candidates: list[Candidate]
    rejections: Rejections


@dataclass(frozen=True, eq=False, slots=True)
class PlacedPrograms:
    """The episodes of a scene with the candidates that could not be placed, and the number of failed draws by cell and
    reason.
    """

    pool: EpisodePool
    rejections: Rejections


def look_around(scene: Scene, walkable: Walkable, places: PlacesConfig, recognition: Recognition) -> list[Visibility]:
    """Return the visibility of every object that is not part of the building, from the positions in its room at which
    an agent can stand.
    """
    islands = wide_islands(walkable.pathfinder, places)
    obstacles = blocked_footprints(scene, walkable.pathfinder, walkable.max_climb)
    pathfinder, height = walkable.pathfinder, places.eye_height
    return list(scene_visibility(scene, walkable.view, pathfinder, islands, height, recognition, obstacles))


def draw_programs(
    scene: Scene,
    facts: Mapping[str, TextFacts],
    bits: PriorBits,
    sightings: Sightings,
    settings: ProgramSettings,
    graph: GraphPathfinder | None = None,
) -> DrawnPrograms:
    """Draw the candidate programs of a scene without a navmesh.

    Without ``graph``, the distance between objects is that of their centres.

    Parameters
    ----------
    facts : what text may state about pairs of objects, by room id
    graph : viewpoint graph of a scan
    """
    placer: GraphPlacer | None = None
    # Samplers by what defines the distance between objects; each fills the cells that the previous ones left short.
    ways = [apart_by_centres(scene, settings.places)]
    if graph is not None:
        # If too few objects have a viewpoint, some instructions are published without episodes.
        ways.insert(0, viewpoint_stops(scene, graph))
        placer = GraphPlacer(scene, graph, settings.seed)
    candidates: list[Candidate] = []
    rejections: Rejections = Counter()
    for stops in ways:
        sampler = ProgramSampler(
            scene,
            facts,
            bits,
            settings.instructions,
            settings.sampling,
            settings.seed,
            stops=stops,
            preamble=settings.preamble,
            placed=False,
            sightings=sightings,
        )
        drawn = draw_candidates(sampler)
        rejections += sampler.rejections
        if placer is not None and stops is ways[0]:
            drawn, refused = _placeable(drawn, placer)
            rejections += refused
        candidates = _filled(candidates, drawn) if candidates else drawn
    return DrawnPrograms(candidates, rejections)


def _placeable(candidates: list[Candidate], placer: GraphPlacer) -> tuple[list[Candidate], Rejections]:
    """Return the candidates that can be placed on the viewpoints, and the numbers of rejections by cell and reason.
    Counterfactual groups are kept or dropped whole.

    Every leaf is checked as if it were gold, so that the selection is independent of the truth.
    """
    refused: Rejections = Counter()
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
    facts: Mapping[str, TextFacts],
    bits: PriorBits,
    walkable: Walkable,
    sightings: Sightings,
    settings: ProgramSettings,
) -> PlacedPrograms:
    """Draw candidate programs of a scene and place them, until each cell has the wanted episodes or is exhausted.

    Parameters
    ----------
    facts : what text may state about pairs of objects, by room id
    """
    pathfinder, placers = walkable.pathfinder, list[Placer]()
    instructions, sampling, preamble = settings.instructions, settings.sampling, settings.preamble
    places, rules, seed = settings.places, settings.episodes, settings.seed
    obstacles = blocked_footprints(scene, pathfinder, walkable.max_climb)

    def reachable(named: frozenset[str]) -> Stops:
        sight = walkable.view, Recognition.of(places, rules)
        points = scene_goals(scene, pathfinder, places, settings.goals, obstacles, sight, named)
        placer = Placer(
            scene,
            pathfinder,
            points,
            places,
            rules,
            seed,
            max_climb=walkable.max_climb,
            thresholds=settings.thresholds,
            sightings=sightings,
        )
        placers.append(placer)
        return reachable_stops(pathfinder, placer.field, placer.leaf_separation)

    # Leaves are checked before one of them is drawn as gold, so that the check can't favour a truth.
    sampler = ProgramSampler(
        scene, facts, bits, instructions, sampling, seed, stops=reachable, preamble=preamble, sightings=sightings
    )
    (placer,) = placers
    observer = Observer(scene, walkable.view, pathfinder, places, rules, obstacles, sightings=sightings)
    looking = LookingPaths(scene, walkable.view, pathfinder, places, rules, observer)
    if any(map(sampler.leads_of, instructions.wanted)):
        placer.leads = LeadPlaces(scene, pathfinder, observer, places, looking.places, placer.starts)
    pool = fill_pool(
        CandidateSupply(sampler),
        placer,
        instructions.wanted,
        instructions.label_cap,
        lambda program: preamble and names_compass(program),
        observer,
        instructions.counterfactual_groups,
        lambda category: (sampling.move_shares(category), sampling.drawn_move_shares(category)),
        looking,
        purposeful=sampling.purpose > 0,
    )
    pool.reject_collisions(scene.scene_id)
    return PlacedPrograms(pool, sampler.rejections)


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

"""Sample candidate programs of one scene: first the leaves, then which leaf is gold, then conditions whose truths lead
to the gold leaf.

Therefore nothing about a leaf reveals that it is gold, and neither label, anchor, kind nor predicate of a statement
reveals its truth. Every draw is seeded by (dataset seed, family, scene, category) only.

Counterfactual groups are four programs of one skeleton, with a condition's truth flipped and two leaves exchanged. A
guesser that ignores the condition gets at most half of the four right, and so does one that always prefers some object.
All four share one start. Each has the stops of all others, so if one can be placed, all can.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Final

from condvln.instructions.cell_drawing import CellDrawing, Seen, WantedCell
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conditions import ConditionPool
from condvln.instructions.degeneracy import GivenUp, degeneracies, searches
from condvln.instructions.likeness import NO_BORDER, borders
from condvln.instructions.predicates import sayable
from condvln.instructions.priors import PriorBits
from condvln.instructions.programs import ID_LENGTH, instruction_id, program_key
from condvln.instructions.referents import Facts, Referents, object_refs, room_refs
from condvln.instructions.rendering import word_count
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import StopNames, Stops, Target, Targets, nameable, targets
from condvln.labels import Vocabulary, vocabulary
from condvln.scene import Scene
from condvln.scene.scene import EVERYTHING_SEEN, Sightings
from condvln.seeding import Draws, generator
from schemas.config import InstructionCell, InstructionsConfig, SamplingConfig
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.episode import Composition
from schemas.program import CATEGORIES, SHAPES, Category, Condition, ObjectRef, Program, RoomRef, asked_in

__all__ = ["Group", "ProgramSampler", "counterfactual_group", "flipped", "group_id", "swapped"]

Group = tuple[Program, Program, Program, Program]
"""The program; with the condition flipped; with the leaves exchanged; with both."""


def counterfactual_group(
    program: Program, condition_sampler: ConditionSampler, draws: Draws, vocabulary: Vocabulary
) -> Group | None:
    """Return the group of `program`; None if no condition on its gold path has a twin.

    The flipped condition is on the gold path, and its flip changes the gold leaf. The last such condition is preferred,
    since it decides between the fewest leaves. The exchanged leaves are the gold ones before and after the flip.
    """
    for index, leaf in _decisive(program):
        if program.led_branches(leaf) != program.led_branches(program.gold_leaf()):
            continue  # exchanged leaves would have other routes
        twin = condition_sampler.twin(program, index, draws)
        if twin is not None:
            other = flipped(program, index, twin)
            group = (
                program,
                other,
                swapped(program, program.gold_leaf(), leaf),
                swapped(other, program.gold_leaf(), leaf),
            )
            if not any(degeneracies(member, vocabulary) for member in group):
                return group
    return None


def _decisive(program: Program) -> Iterator[tuple[int, int]]:
    """Yield (condition, leaf) for each condition on the gold path whose flip leads to another leaf: the index of the
    condition, and that other leaf. The last condition comes first.
    """
    truths = [condition.truth for condition in program.conditions]
    for index in reversed(program.route()[0]):
        turned = [*truths[:index], not truths[index], *truths[index + 1 :]]
        leaf = program.gold_leaf(turned)
        if leaf != program.gold_leaf():
            yield index, leaf


def flipped(program: Program, index: int, twin: Condition) -> Program:
    """Return `program` with condition `index` replaced by `twin`, which has the opposite truth."""
    conditions = (*program.conditions[:index], twin, *program.conditions[index + 1 :])
    return Program(category=program.category, conditions=conditions, branches=program.branches, leaves=program.leaves)


def swapped(program: Program, one: int, other: int) -> Program:
    """Return `program` with the leaves at the indices `one` and `other` exchanged."""
    leaves = list(program.leaves)
    leaves[one], leaves[other] = leaves[other], leaves[one]
    return Program(
        category=program.category,
        conditions=program.conditions,
        branches=program.branches,
        leaves=tuple(leaves),
    )


def group_id(family: str, scene_id: str, group: Group) -> str:
    """Return the id of a group; all programs of the group share the id."""
    keys = "\x1f".join(sorted(program_key(program) for program in group))
    return hashlib.sha256(f"{family}\x1f{scene_id}\x1f{keys}".encode()).hexdigest()[:ID_LENGTH]


LEAD_FACTOR: Final = 2
"""Factor on the candidates with leads, since placing rejects more of them."""
TRIES_PER_CANDIDATE: Final = 2
"""Number of shapes tried per wanted candidate, so that a scene reaches its number although some shapes are
impossible.
"""


class ProgramSampler:
    """Samples candidate programs of one scene.

    Parameters
    ----------
    facts : facts that text may use, by room id
    bits : the priors' bits that this scene reads (``LabelPriors.bits``)
    stops : reachable objects and their distances, or a function that returns those among the objects that text can
        name, by their ids; ``apart_by_centres`` without a navmesh
    sightings : which objects are invisible; by default only those in shut containers
    preamble : whether texts that use compass words begin with the start heading; matters for cells with bounds on the
        number of words
    placed : programs are placed on a navmesh, so that a start can be chosen for egocentric statements

    """

    def __init__(
        self,
        scene: Scene,
        facts: Mapping[str, Facts],
        bits: PriorBits,
        wanted: InstructionsConfig,
        sampling: SamplingConfig,
        seed: int,
        *,
        stops: Stops | Callable[[frozenset[str]], Stops],
        preamble: bool,
        placed: bool = True,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self.scene, self.wanted, self.sampling, self.seed = scene, wanted, sampling, seed
        self.preamble, self._placed = preamble, placed
        self._sayable = sayable(wanted.directions, placed=placed)
        self._reasons: dict[InstructionCell | None, Counter[str]] = {}
        astride = borders(scene)
        self.referents = {
            room.room_id: Referents.of(
                room,
                scene.arrays(room.room_id),
                facts[room.room_id],
                vocabulary,
                sampling.anchor_size,
                scene.family,
                sightings,
                self._sayable,
                astride.get(room.room_id, NO_BORDER),
            )
            for room in sorted(scene.rooms, key=lambda r: r.room_id)
            if room.room_id in facts
        }
        self._names = room_refs(list(self.referents.values()), vocabulary)
        if not isinstance(stops, Stops):
            stops = stops(frozenset(name for *_, name in nameable(self.referents, self._names)))
        found = targets(self.referents, self._names, stops, sampling, vocabulary)
        self.condition_sampler = self._alone = self._condition_sampler(bits, found, alone=False)
        if bits.staged:  # statements about stagings have other weights in programs of one condition
            self._alone = self._condition_sampler(bits, found, alone=True)
        self.stop_sampler = StopSampler(
            found,
            {room_id: self.referents[room_id].room.label for room_id in sorted(self._names)},
            [room_id for room_id in self._names if self._is_plain(room_id)],
            self.condition_sampler.rooms,
            self.condition_sampler.is_left_by,
        )
        self.stop_names = StopNames(self._names, self._refs_of, sampling, vocabulary)

    def _condition_sampler(self, bits: PriorBits, found: Targets, *, alone: bool) -> ConditionSampler:
        """Return a sampler of conditions about the rooms that can be named, for programs of one condition (`alone`) or
        of several.
        """
        return ConditionSampler(
            {name: (self.referents[name], self._pool(name, bits, alone=alone)) for name in self._names},
            self.sampling,
            vocabulary,
            found,
            [name for name in self._names if self._is_plain(name)],
            single_room=self.scene.single_room,
        )

    def _sampler_of(self, category: Category) -> ConditionSampler:
        """Return the sampler of conditions for programs of a category."""
        return self.condition_sampler if len(SHAPES[category].branches) > 1 else self._alone

    def _pool(self, room_id: str, bits: PriorBits, *, alone: bool) -> ConditionPool:
        referents = self.referents[room_id]
        if self.scene.single_room:
            elsewhere = set(bits.plausible.get(referents.room.label, ()))
        else:
            elsewhere = {o.label for o in self.scene.objects if o.room_id != room_id and not o.hidden}
        asked = asked_in(self.scene.family) & self._sayable
        usual = self.sampling.usual_places
        return ConditionPool.of(referents, bits, elsewhere, vocabulary, asked, alone=alone, usual_places=usual)

    @property
    def rejections(self) -> Counter[tuple[InstructionCell | None, str]]:
        """Return, by cell (None for counterfactual groups) and reason, the number of draws, or parts of draws, that
        were rejected.
        """
        return Counter(
            {(cell, reason): count for cell, reasons in self._reasons.items() for reason, count in reasons.items()}
        )

    @cached_property
    def label_cap(self) -> float:
        """Maximum share of leaf targets that may have the same label. If the scene has too few labels for the wanted
        share, the maximum is an equal share for each label.
        """
        return max(self.wanted.label_cap, 1.0 / max(1, len(self.stop_sampler.weights)))

    def _most_goals(self, category: Category) -> float:
        """Return how often a label may be a goal of candidates of a category."""
        candidates = sum(self.sampling.candidates(cell) for cell in self.wanted.cells_of(category))
        return max(1.0, self.label_cap * candidates * SHAPES[category].leaves)

    def candidates(self, category: Category) -> Iterator[Program]:
        """Yield distinct programs for all wanted cells of a category, in a seeded order."""
        return (program for _, program in self.drawn(category))

    def drawn(self, category: Category) -> Iterator[tuple[InstructionCell, Program]]:
        """Yield up to ``sampling.candidates(cell)`` programs of each cell of a category, all distinct, with their
        cells.
        """
        seen = Seen()
        for cell in self.wanted.cells_of(category):
            drawing = self.drawing(cell, seen)
            if drawing is not None:
                for program in self.programs(cell, drawing, self.sampling.candidates(cell)):
                    yield cell, program

    def drawing(self, cell: InstructionCell, seen: Seen, *, leads: bool = False) -> CellDrawing | None:
        """Return a drawing of at most ``sampling.candidates(cell)`` candidates of a cell, for `programs`. Return None,
        and count the reason, if the scene has none. The drawings of the cells of a category share what is `seen`, so
        that all of their programs are distinct.
        """
        category, wanted = cell.category, self.sampling.candidates(cell) * (LEAD_FACTOR if leads else 1)
        reasons = self._reasons.setdefault(cell, Counter())
        if not wanted:
            return None
        if not self.condition_sampler.rooms:
            reasons["nothing_to_ask"] += 1
            return None
        if not self.stop_sampler.fits(SHAPES[category].leaves):
            reasons["no_targets"] += 1
            return None
        purpose = ("programs", category, cell.name) if cell.drawn else ("programs", category)
        purpose = (*purpose, "leads") if leads else purpose
        draws = Draws(generator(self.seed, self.scene.family, self.scene.scene_id, *purpose))
        kind = self._wanted_cell(cell, self.sampling.drawn_move_shares(category), leads=leads)
        goal_draws = Draws(generator(self.seed, self.scene.family, self.scene.scene_id, *purpose, "goals"))
        return self._drawing(kind, wanted, draws, goal_draws, seen)

    def programs(self, cell: InstructionCell, drawing: CellDrawing, count: int) -> Iterator[Program]:
        """Yield the next `count` programs of a cell's drawing, fewer if it is exhausted."""
        reasons = self._reasons[cell]
        while count > 0:
            found = drawing.draw(1, reasons)
            if not found:
                return
            try:
                if cell.words is not None:
                    self._worded(found[0], cell.words)
            except GivenUp as given_up:
                reasons[given_up.reason] += 1
                drawing.refuse()
            else:
                count -= 1
                yield found[0]

    def _drawing(self, wanted: WantedCell, most: int, draws: Draws, goal_draws: Draws, seen: Seen) -> CellDrawing:
        """Return a drawing of at most `most` candidates of a cell."""
        conditions = self._sampler_of(wanted.category)
        shapes, stops, names = most * TRIES_PER_CANDIDATE, self.stop_sampler, self.stop_names
        return CellDrawing(wanted, most, shapes, draws, goal_draws, seen, stops, names, conditions, vocabulary)

    def _wanted_cell(self, cell: InstructionCell, moves: Sequence[float], *, leads: bool = False) -> WantedCell:
        """Return what is wanted of the candidates of a cell.

        moves : shares of leaves with 1, 2, … moves, unless the cell says their number
        """
        return WantedCell(
            category=cell.category,
            compositions=self._compositions(cell.category) if cell.composition is None else {cell.composition: 1.0},
            move_shares=moves,
            moves=cell.moves,
            label_cap=self._most_goals(cell.category),
            draws=self.sampling.draws_per_candidate,
            bearings=self.sampling.bearings,
            # Evidence that must be in the first view is never behind, so "behind" would reveal the truth.
            egocentric=cell.observability != "O0f",
            leads=leads,
            compass=self.sampling.compass_share,
            compass_phrases=self.sampling.compass_phrases,
            purpose=self.sampling.purpose,
            most_odd=self.sampling.most_odd,
            search=self.sampling.search if searches(cell.category) else 0.0,
        )

    def leads_of(self, cell: InstructionCell) -> float:
        """Return the share of a cell's programs that shall have leads: none where there is one room, or no navmesh."""
        wanted = self.wanted.leads if cell.leads is None else float(cell.leads == "with")
        return 0.0 if self.scene.single_room or not self._placed else wanted

    def _worded(self, program: Program, words: tuple[int, int]) -> None:
        """Raise GivenUp if the text of `program` has not the number of words that a cell asks for."""
        name = instruction_id(self.scene.family, self.scene.scene_id, program)
        least, most = words
        said = word_count(program, self.seed, name, self.wanted.wording, preamble=self.preamble)
        if not least <= said <= most:
            raise GivenUp("words_missed")

    def groups(self) -> Iterator[Group]:
        """Yield distinct counterfactual groups, cycling through categories; as many candidates are drawn for each
        wanted group as for a wanted episode.
        """
        wanted = self.wanted.counterfactual_groups * self.sampling.candidates_per_episode
        cells = [cells for cells in map(self.wanted.cells_of, CATEGORIES) if cells]
        if not wanted or not cells or not self.condition_sampler.rooms:
            return
        draws = Draws(generator(self.seed, self.scene.family, self.scene.scene_id, "counterfactual groups"))
        order, reasons = draws.sample(cells, len(cells)), self._reasons.setdefault(None, Counter())
        seen: set[Program] = set()
        drawings: dict[InstructionCell, CellDrawing] = {}
        for k in range(wanted):
            cell = draws.choice(order[k % len(order)])
            if cell not in drawings:
                # Placing takes the first groups that fit and can't choose among them by their moves, and it hardly
                # rejects more of those with long routes. So the shares that are wanted are drawn.
                kind = self._wanted_cell(cell, self.sampling.move_shares(cell.category))
                drawings[cell] = self._drawing(kind, 1, draws, draws, Seen(keys=None))
            drawing = drawings[cell]
            drawing.begin(draws.index(SHAPES[cell.category].leaves))
            drawing.leads = k < self.leads_of(cell) * wanted  # the first groups that fit are taken
            while found := drawing.draw(1, reasons):
                try:
                    group = self._group(found[0], seen, draws)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                else:
                    if seen.isdisjoint(group):
                        seen.update(group)
                        yield group
                        break
                drawing.refuse()

    def _group(self, program: Program, seen: set[Program], draws: Draws) -> Group:
        if program in seen:
            raise GivenUp("duplicate")
        group = counterfactual_group(program, self._sampler_of(program.category), draws, vocabulary)
        if group is None:
            raise GivenUp("no_twin")
        return group

    def _compositions(self, category: Category) -> dict[Composition, float]:
        """Return the compositions that the rooms allow for a category, and their weights."""
        weights = self.sampling.compositions
        kinds, plain = self.stop_sampler.kinds, sum(map(self._is_plain, self._names))
        # Where too few rooms have a plain name, a text over many rooms is rare: it needs "the bedroom that has …".
        two, three = (1.0 if plain >= count else 1.0 / PLAIN_ROOM_WEIGHT for count in (2, 3))
        possible: dict[Composition, tuple[bool, float]] = {
            "C0": (bool(self.stop_sampler.roomy(SHAPES[category].leaves)), weights.C0),
            "C1": (kinds > 1, weights.C1 * two),
            "C2": (kinds > 2, weights.C2 * three),
        }
        return {name: weight for name, (there_are_rooms, weight) in possible.items() if there_are_rooms}

    def _is_plain(self, room_id: str) -> bool:
        """Return whether a room's label alone names it."""
        return self._names[room_id][0].anchor_label is None

    def _refs_of(self, target: Target, room: RoomRef) -> tuple[ObjectRef, ...]:
        """Return the references to a target in a room with a certain name."""
        return object_refs(self.referents[target.room_id], target.index, room)

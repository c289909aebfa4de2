"""Sample candidate programs of one scene: first the leaves, then which leaf is gold, then conditions whose truths lead
to the gold leaf.

Therefore nothing about a leaf reveals that it is gold, and neither label, anchor, kind nor predicate of a statement
reveals its truth. Every draw is seeded by (dataset seed, family, scene, category) only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property, partial
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np

from condvln.instructions.borders import NO_BORDER, borders
from condvln.instructions.cell_drawing import CellDrawing, DrawnCandidate, Seen
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conditions import ConditionPool
from condvln.instructions.counterfactuals import Group, counterfactual_group
from condvln.instructions.degeneracy import is_circular, outcomes
from condvln.instructions.kernels.candidates import WantedCell
from condvln.instructions.name_tables import NumberedNames
from condvln.instructions.predicates import sayable
from condvln.instructions.priors import PriorBits
from condvln.instructions.programs import COMPOSITIONS, instruction_id, side_masks
from condvln.instructions.referents import Facts, Referents, object_refs, room_refs
from condvln.instructions.rejection import GivenUp
from condvln.instructions.rendering import word_count
from condvln.instructions.stop_sampler import ROOM_SPANS, StopSampler
from condvln.instructions.stops import Stops, Target, nameable, targets
from condvln.labels import Vocabulary, vocabulary
from condvln.scene import Scene
from condvln.scene.sightings import EVERYTHING_SEEN, Sightings
from condvln.seeding import Draws, generator
from schemas.config import InstructionCell, InstructionsConfig, SamplingConfig
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.episode import Composition
from schemas.program import CATEGORIES, SHAPES, Category, Leaf, ObjectRef, Program, RoomRef, asked_in

__all__ = ["Outline", "ProgramSampler"]

TRIES_PER_CANDIDATE: Final = 2
"""Number of shapes tried per wanted candidate, so that a scene reaches its number although some shapes are
impossible.
"""

VAIN_TRIES: Final = 100
"""Number of consecutive shapes, each tried many times, after which a cell counts as exhausted."""


class Outline(NamedTuple):
    """What decides whether a program that was drawn is wanted, and a function that returns the program.

    moves : number of moves of each leaf
    labels : target label of each leaf
    gold : index of the gold leaf
    """

    moves: tuple[int, ...]
    labels: tuple[str, ...]
    gold: int
    program: Callable[[], Program]


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
        words: Vocabulary = vocabulary,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self.scene, self.wanted, self.sampling, self.seed = scene, wanted, sampling, seed
        self.preamble = preamble
        self._sayable = sayable(wanted.directions, placed=placed)
        self.words = words
        self._reasons: dict[InstructionCell | None, Counter[str]] = {}
        astride = borders(scene)
        self.referents = {
            room.room_id: Referents.of(
                room,
                scene.arrays(room.room_id),
                facts[room.room_id],
                words,
                sampling.anchor_size,
                scene.family,
                sightings,
                self._sayable,
                astride.get(room.room_id, NO_BORDER),
            )
            for room in sorted(scene.rooms, key=lambda r: r.room_id)
            if room.room_id in facts
        }
        self._names = room_refs(list(self.referents.values()), words)
        # Statements about stagings have other weights in programs of one condition.
        self.condition_sampler, *others = self._condition_samplers(bits, (False, True) if bits.staged else (False,))
        self._alone = others[0] if others else self.condition_sampler
        if not isinstance(stops, Stops):
            stops = stops(frozenset(name for *_, name in nameable(self.referents, self._names)))
        self.stop_sampler = StopSampler(
            targets(self.referents, self._names, stops, sampling, words),
            {room_id: self.referents[room_id].room.label for room_id in sorted(self._names)},
            [room_id for room_id in self._names if self._is_plain(room_id)],
            self.condition_sampler.rooms,
            self.condition_sampler.is_left_by,
        )
        self._known_compositions: dict[Category, tuple[tuple[Composition, ...], tuple[float, ...]]] = {}
        self._refs: dict[tuple[str, str | None, str], tuple[ObjectRef, ...]] = {}
        self._known_names: dict[int, NumberedNames] = {}

    def _condition_samplers(self, bits: PriorBits, ways: Sequence[bool]) -> list[ConditionSampler]:
        """Return samplers of conditions about the rooms that can be named: for programs of one condition where `ways`
        says so, else for those of several.
        """
        pools = {name: self._pools(name, bits, ways) for name in self._names}
        return [
            ConditionSampler(
                {name: (self.referents[name], own[k]) for name, own in pools.items()},
                self.sampling,
                self.words,
                single_room=self.scene.single_room,
            )
            for k in range(len(ways))
        ]

    def _sampler_of(self, category: Category) -> ConditionSampler:
        """Return the sampler of conditions for programs of a category."""
        return self.condition_sampler if len(SHAPES[category].branches) > 1 else self._alone

    def _pools(self, room_id: str, bits: PriorBits, ways: Sequence[bool]) -> tuple[ConditionPool, ...]:
        referents = self.referents[room_id]
        if self.scene.single_room:
            elsewhere = set(bits.plausible.get(referents.room.label, ()))
        else:
            elsewhere = {o.label for o in self.scene.objects if o.room_id != room_id and not o.hidden}
        asked = asked_in(self.scene.family) & self._sayable
        return ConditionPool.weighed(referents, bits, elsewhere, self.words, asked, ways)

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
        return max(self.wanted.label_cap, 1.0 / max(1, len(self.stop_sampler.labels)))

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
        seen = self.nothing_seen(category)
        for cell in self.wanted.cells_of(category):
            drawing = self.drawing(cell, seen)
            if drawing is not None:
                for program in self.programs(cell, drawing, self.sampling.candidates(cell)):
                    yield cell, program

    def nothing_seen(self, category: Category) -> Seen:
        """Return what the drawings of the cells of a category share, so that all of their programs are distinct."""
        return self._seen(category, sum(map(self.sampling.candidates, self.wanted.cells_of(category))))

    def _seen(self, category: Category, most: int) -> Seen:
        """Return that nothing is seen yet of at most so many candidates of a category."""
        shape = SHAPES[category]
        return Seen(most, shape.leaves, len(shape.branches), len(self.stop_sampler.labels))

    def drawing(self, cell: InstructionCell, seen: Seen) -> CellDrawing | None:
        """Return a drawing of at most ``sampling.candidates(cell)`` candidates of a cell, for `programs`. Return None,
        and count the reason, if the scene has none.
        """
        category, wanted = cell.category, self.sampling.candidates(cell)
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
        draws = Draws(generator(self.seed, self.scene.family, self.scene.scene_id, *purpose))
        kind = self._wanted_cell(cell, self.sampling.drawn_move_shares(category))
        return self._drawing(category, kind, wanted, draws, seen)

    def programs(self, cell: InstructionCell, drawing: CellDrawing, count: int) -> Iterator[Program]:
        """Yield the next `count` programs of a cell's drawing, fewer if it is exhausted."""
        return (outline.program() for outline in self.outlines(cell, drawing, count))

    def outlines(self, cell: InstructionCell, drawing: CellDrawing, count: int) -> Iterator[Outline]:
        """Yield the outlines of the next `count` programs of a cell's drawing, fewer if it is exhausted."""
        category, reasons = cell.category, self._reasons[cell]
        # Only the number of words is decided here, so that candidates of other cells are drawn all at once.
        step = count if cell.words is None else 1
        refs = self._numbered_names(self._sampler_of(category)).refs
        while count > 0:
            found = drawing.draw(min(step, count), reasons)
            for one in found:
                program = partial(self._program, category, one)
                try:
                    if cell.words is not None:
                        self._worded(program(), cell.words)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                    drawing.refuse()
                else:
                    count -= 1
                    labels = tuple([refs[stops[-1]].label for stops in one.stops])
                    yield Outline(tuple(map(len, one.stops)), labels, one.gold, program)
            if len(found) < step:
                return

    def _drawing(self, category: Category, wanted: WantedCell, most: int, draws: Draws, seen: Seen) -> CellDrawing:
        """Return a drawing of at most `most` candidates of a cell."""
        sampler = self._sampler_of(category)
        names, shapes = self._numbered_names(sampler), most * TRIES_PER_CANDIDATE
        return CellDrawing(wanted, most, shapes, draws, seen, self.stop_sampler, names, sampler)

    def _wanted_cell(self, cell: InstructionCell, moves: Sequence[float]) -> WantedCell:
        """Return what is wanted of the candidates of a cell.

        moves : shares of leaves with 1, 2, … moves, unless the cell says their number
        """
        category, composition = cell.category, cell.composition
        names, sums = self._compositions(category) if composition is None else ((composition,), ())
        truths = [_leading_to(category, gold) for gold in range(SHAPES[category].leaves)]
        roomy, roomy_sums, roomy_sizes = self.stop_sampler.roomy_tables(SHAPES[category].leaves)
        asked, below = side_masks(category)
        padded = np.zeros((len(truths), max(map(len, truths)), len(asked)), bool)
        for gold, rows in enumerate(truths):
            padded[gold, : len(rows)] = rows
        return WantedCell(
            compositions=np.array([COMPOSITIONS.index(name) for name in names], np.int64),
            composition_sums=np.array(sums, np.float64),
            spans=ROOM_SPANS,
            kinds=self.stop_sampler.kinds,
            roomy=roomy,
            roomy_sums=roomy_sums,
            roomy_sizes=roomy_sizes,
            move_sums=np.array(tuple(accumulate(moves)), np.float64),
            moves=cell.moves or 0,
            golds=np.arange(len(truths)),
            truths=padded,
            truth_sizes=np.array([len(rows) for rows in truths], np.int64),
            asked=asked,
            below=below,
            cap=self._most_goals(category),
            draws=self.sampling.draws_per_candidate,
            vain=VAIN_TRIES,
            bearings=self.sampling.bearings,
            # Evidence that must be in the first view is never behind, so "behind" would reveal the truth.
            egocentric=cell.observability != "O0f",
            attempts=self.sampling.attempts,
        )

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
        seen: set[tuple[object, ...]] = set()
        drawings: dict[InstructionCell, CellDrawing] = {}
        for k in range(wanted):
            cell = draws.choice(order[k % len(order)])
            if cell not in drawings:
                # Placing takes the first groups that fit and can't choose among them by their moves, and it hardly
                # rejects more of those with long routes. So the shares that are wanted are drawn.
                kind = self._wanted_cell(cell, self.sampling.move_shares(cell.category))
                drawings[cell] = self._drawing(cell.category, kind, 1, draws, self._seen(cell.category, 0))
            drawing = drawings[cell]
            drawing.begin(draws.index(SHAPES[cell.category].leaves))
            while found := drawing.draw(1, reasons):
                program = self._program(cell.category, found[0])
                try:
                    _unseen(program, seen)
                    group = self._group(program, draws)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                else:
                    keys = set(map(_key, group))
                    if not seen & keys:
                        seen.update(keys)
                        yield group
                        break
                drawing.refuse()

    def _group(self, program: Program, draws: Draws) -> Group:
        group = counterfactual_group(program, self._sampler_of(program.category), draws, self.words)
        if group is None:
            raise GivenUp("no_twin")
        return group

    def _compositions(self, category: Category) -> tuple[tuple[Composition, ...], tuple[float, ...]]:
        """Return the compositions that the rooms allow for a category, and their running weights; none if all weights
        are 0.
        """
        if category not in self._known_compositions:
            weights = self.sampling.compositions
            kinds, plain = self.stop_sampler.kinds, sum(map(self._is_plain, self._names))
            # Where too few rooms have a plain name, a text over many rooms is rare: it needs "the bedroom that has …".
            two, three = (1.0 if plain >= count else 1.0 / PLAIN_ROOM_WEIGHT for count in (2, 3))
            possible: dict[Composition, tuple[bool, float]] = {
                "C0": (self.stop_sampler.roomy(SHAPES[category].leaves), weights.C0),
                "C1": (kinds > 1, weights.C1 * two),
                "C2": (kinds > 2, weights.C2 * three),
            }
            options = {name: weight for name, (there_are_rooms, weight) in possible.items() if there_are_rooms}
            found = (tuple(options), tuple(accumulate(options.values()))) if any(options.values()) else ((), ())
            self._known_compositions[category] = found
        return self._known_compositions[category]

    def _program(self, category: Category, drawn: DrawnCandidate) -> Program:
        """Return the program that was drawn."""
        sampler = self._sampler_of(category)
        refs = self._numbered_names(sampler).refs
        names = [
            self._names[self.stop_sampler.rooms[room]][k] for room, k in zip(drawn.rooms, drawn.room_names, strict=True)
        ]
        # What the kernel draws needs no check of its types.
        return Program.model_construct(
            category=category,
            conditions=sampler.conditions(drawn.conditions, _leading_to(category, drawn.gold)[drawn.truths], names),
            branches=SHAPES[category].branches,
            leaves=tuple([Leaf.model_construct(moves=tuple([refs[k] for k in stops])) for stops in drawn.stops]),
        )

    def _is_plain(self, room_id: str) -> bool:
        """Return whether a room's label alone names it."""
        return self._names[room_id][0].anchor_label is None

    def _numbered_names(self, sampler: ConditionSampler) -> NumberedNames:
        """Return the names of rooms and targets by numbers, with the labels numbered as in a sampler's statements."""
        known = self._known_names.get(id(sampler))
        if known is None:
            known = self._known_names[id(sampler)] = NumberedNames(
                {room_id: self._names[room_id] for room_id in self.stop_sampler.rooms},
                self.stop_sampler.targets,
                self._names_of,
                sampler.numbered,
                self.sampling,
                sampler.rooms,
                self.condition_sampler.start_rooms,
            )
        return known

    def _names_of(self, target: Target, room: RoomRef) -> tuple[ObjectRef, ...]:
        """Return the names of a target in a room with a certain name."""
        key = (room.room_id, room.anchor_id, target.object_id)
        if key not in self._refs:
            refs = object_refs(self.referents[target.room_id], target.index, room)
            self._refs[key] = tuple(ref for ref in refs if not is_circular(ref, self.words))
        return self._refs[key]


@cache
def _leading_to(category: Category, gold: int) -> tuple[tuple[bool, ...], ...]:
    """Return the truths of conditions that lead to a leaf. Truths that don't matter on the way there are fair coins."""
    return tuple(truths for truths, leaf in outcomes(category).items() if leaf == gold)


def _key(program: Program) -> tuple[object, ...]:
    """Return what distinguishes a program from the other programs of a sampler. The sampler makes each condition and
    each name of a stop once.
    """
    moves = (move for leaf in program.leaves for move in (*leaf.moves, None))
    return (program.category, *map(id, program.conditions), *map(id, moves))


def _unseen(program: Program, seen: set[tuple[object, ...]]) -> tuple[object, ...]:
    """Return the key of a program; raise GivenUp if it was `seen`."""
    key = _key(program)
    if key in seen:
        raise GivenUp("duplicate")
    return key

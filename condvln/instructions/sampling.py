"""Sample candidate programs of one scene: first the leaves, then which leaf is gold, then conditions whose truths lead
to the gold leaf.

Therefore nothing about a leaf reveals that it is gold, and neither label, anchor, kind nor predicate of a statement
reveals its truth. Every draw is seeded by (dataset seed, family, scene, category) only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.borders import NO_BORDER, borders
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conditions import ConditionPool
from condvln.instructions.counterfactuals import Group, counterfactual_group
from condvln.instructions.degeneracy import idle_conditions, is_circular, outcomes
from condvln.instructions.kernels.conditions import RULES
from condvln.instructions.kernels.programs import REASONS, DrawnProgram, WantedProgram, draw_program, drawn_program
from condvln.instructions.name_tables import NumberedNames
from condvln.instructions.predicates import sayable
from condvln.instructions.priors import PriorBits
from condvln.instructions.programs import composition, instruction_id
from condvln.instructions.referents import Facts, Referents, object_refs, room_refs
from condvln.instructions.rejection import GivenUp
from condvln.instructions.rendering import word_count
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import Stops, Target, nameable, targets
from condvln.labels import Vocabulary, vocabulary
from condvln.scene import Scene
from condvln.scene.sightings import EVERYTHING_SEEN, Sightings
from condvln.seeding import Draws, generator
from schemas.config import InstructionCell, InstructionsConfig, SamplingConfig
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.episode import Composition
from schemas.program import CATEGORIES, SHAPES, Category, Leaf, ObjectRef, Program, RoomRef, asked_in

__all__ = ["ProgramSampler"]

TRIES_PER_CANDIDATE: Final = 2
"""Number of shapes tried per wanted candidate, so that a scene reaches its number although some shapes are
impossible.
"""

VAIN_TRIES: Final = 100
"""Number of consecutive shapes, each tried many times, after which a cell counts as exhausted."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """The requested form of a candidate: its composition (None if rooms allow any) and the number of moves of each
    leaf.

    bearings : the candidate may have egocentric statements
    gold : index of the leaf to which the truths of the candidate's conditions lead
    """

    composition: Composition | None
    moves: tuple[int, ...]
    bearings: bool
    gold: int


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
        self.condition_sampler = self._condition_sampler(bits, alone=False)
        # Statements about stagings have other weights in programs of one condition.
        self._alone = self._condition_sampler(bits, alone=True) if bits.even else self.condition_sampler
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

    def _condition_sampler(self, bits: PriorBits, *, alone: bool) -> ConditionSampler:
        """Return a sampler of conditions about the rooms that can be named.

        alone : the conditions are for programs of one condition
        """
        pools = {name: (self.referents[name], self._pool(name, bits, alone=alone)) for name in self._names}
        return ConditionSampler(pools, self.sampling, self.words, single_room=self.scene.single_room)

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
        return ConditionPool.of(referents, bits, elsewhere, self.words, asked, alone=alone)

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
        seen: set[tuple[object, ...]] = set()
        used: Counter[str] = Counter()
        for cell in self.wanted.cells_of(category):
            for program in self._drawn(cell, seen, used):
                yield cell, program

    def _drawn(self, cell: InstructionCell, seen: set[tuple[object, ...]], used: Counter[str]) -> Iterator[Program]:
        category, wanted = cell.category, self.sampling.candidates(cell)
        reasons = self._reasons.setdefault(cell, Counter())
        if wanted and not self.condition_sampler.rooms:
            reasons["nothing_to_ask"] += 1
            return
        purpose = ("programs", category, cell.name) if cell.drawn else ("programs", category)
        draws = Draws(generator(self.seed, self.scene.family, self.scene.scene_id, *purpose))
        n_leaves, cap = SHAPES[category].leaves, self._most_goals(category)
        if wanted and not self.stop_sampler.fits(n_leaves):
            reasons["no_targets"] += 1
            return
        golds: list[int] = []
        found = failed = 0
        for _ in range(wanted * TRIES_PER_CANDIDATE):
            if found >= wanted or failed >= VAIN_TRIES:
                return
            failed += 1
            # Each leaf is gold as often as the others: the pool takes no more of one than of another.
            golds = golds or draws.sample(range(n_leaves), n_leaves)
            # A shape that is hard to draw is not replaced by an easy one; it is tried until it succeeds.
            shape = self._shape(cell, draws, golds.pop(), self.sampling.drawn_move_shares(category))
            for program in self._tries(reasons, category, shape, used, cap, draws):
                try:
                    key = _unseen(program, seen)
                    self._worded(cell, program)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                    continue
                seen.add(key)
                found, failed = found + 1, 0
                used.update(leaf.goal.label for leaf in program.leaves)
                yield program
                break

    def _tries(
        self,
        rejected: Counter[str],
        category: Category,
        shape: _Shape,
        used: Counter[str],
        cap: float,
        draws: Draws,
    ) -> Iterator[Program]:
        """Yield programs for a candidate, again and again until there were as many draws as a candidate may take. Draws
        that fail, and conditions that violate a rule, are added to `rejected`.
        """
        left = self.sampling.draws_per_candidate
        stops = self.stop_sampler.wanted(shape.composition, shape.moves, used, cap)
        if isinstance(stops, str):
            rejected[stops] += left
            return
        sampler, truths = self._sampler_of(category), _leading_to(category, shape.gold)
        names = self._numbered_names(sampler)
        wanted = WantedProgram(
            stops, self.sampling.bearings, shape.bearings, np.array(truths, bool), self.sampling.attempts
        )

        def draw(stream: NDArray[np.float64], unread: NDArray[np.int64]) -> tuple[int, DrawnProgram]:
            found = drawn_program(len(shape.moves), stops.most, len(truths[0]))
            numbered, targets = sampler.numbered.tables, self.stop_sampler
            return draw_program(
                left, wanted, targets.room_of, targets.tables, names.tables, numbered, stream, unread, found
            ), found

        while left > 0:
            failed, found = draws.compiled(draw)
            for reasons, counts in ((REASONS, found.failures), (RULES, found.clashes)):
                for reason, count in zip(reasons, counts.tolist(), strict=True):
                    if count:
                        rejected[reason] += count
            if failed == left:
                return
            left -= failed + 1
            try:
                yield self._program(category, shape, found, sampler, names, truths[int(found.truths[0])])
            except GivenUp as given_up:
                rejected[given_up.reason] += 1

    def _worded(self, cell: InstructionCell, program: Program) -> None:
        """Raise GivenUp if the text of `program` has not the number of words that the cell asks for."""
        if cell.words is not None:
            name = instruction_id(self.scene.family, self.scene.scene_id, program)
            least, most = cell.words
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
        unused: Counter[str] = Counter()
        for k in range(wanted):
            cell = draws.choice(order[k % len(order)])
            # Placing takes the first groups that fit and can't choose among them by their moves, and it hardly rejects
            # more of those with long routes. So the shares that are wanted are drawn.
            shares = self.sampling.move_shares(cell.category)
            shape = self._shape(cell, draws, draws.index(SHAPES[cell.category].leaves), shares)
            for program in self._tries(reasons, cell.category, shape, unused, self._most_goals(cell.category), draws):
                try:
                    _unseen(program, seen)
                    group = self._group(program, draws)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                    continue
                keys = set(map(_key, group))
                if not seen & keys:
                    seen.update(keys)
                    yield group
                    break

    def _group(self, program: Program, draws: Draws) -> Group:
        group = counterfactual_group(program, self._sampler_of(program.category), draws, self.words)
        if group is None:
            raise GivenUp("no_twin")
        return group

    def _shape(self, cell: InstructionCell, draws: Draws, gold: int, moves: Sequence[float]) -> _Shape:
        """Return a drawn shape for `cell`. `moves` are the shares of leaves with 1, 2, … moves, unless the cell says
        their number.
        """
        category, wanted = cell.category, cell.composition
        if wanted is None:
            names, sums = self._compositions(category)
            wanted = names[draws.cumulative(sums)] if names else None
        n_leaves = SHAPES[category].leaves
        # Evidence that must be in the first view is never behind, so "behind" would reveal the truth.
        bearings = cell.observability != "O0f"
        if cell.moves is not None:
            return _Shape(wanted, (cell.moves,) * n_leaves, bearings, gold)
        shares = tuple(accumulate(moves))
        return _Shape(wanted, tuple(1 + draws.cumulative(shares) for _ in range(n_leaves)), bearings, gold)

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

    def _program(
        self,
        category: Category,
        shape: _Shape,
        found: DrawnProgram,
        sampler: ConditionSampler,
        known: NumberedNames,
        truths: Sequence[bool],
    ) -> Program:
        """Return the program that was drawn; raise GivenUp if it has not the composition of the shape."""
        rooms = found.rooms[1 : 1 + found.rooms[0]].tolist()
        names = [
            self._names[self.stop_sampler.rooms[room]][k]
            for room, k in zip(rooms, found.room_names.tolist()[: len(rooms)], strict=True)
        ]
        # What the kernel draws needs no check of its types.
        leaves = tuple(
            [
                Leaf.model_construct(moves=tuple([known.refs[k] for k in refs[:count]]))
                for refs, count in zip(found.names.tolist(), shape.moves, strict=True)
            ]
        )
        goals = [leaf.moves[-1].object_id for leaf in leaves]
        if len(set(goals)) < len(goals) and idle_conditions(category, goals):
            raise GivenUp("idle_condition")
        program = Program.model_construct(
            category=category,
            conditions=sampler.conditions(found.conditions.tolist(), truths, names),
            branches=SHAPES[category].branches,
            leaves=leaves,
        )
        if composition(program) != shape.composition:
            raise GivenUp("composition_missed")
        return program

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

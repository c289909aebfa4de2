"""Sample candidate programs of one scene: first the leaves, then which leaf is gold, then conditions whose truths lead
to the gold leaf.

Therefore nothing about a leaf reveals that it is gold, and neither label, anchor, kind nor predicate of a statement
reveals its truth. Every draw is seeded by (dataset seed, family, scene, category) only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from typing import Final

from condvln.instructions.borders import NO_BORDER, borders
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conditions import ConditionPool
from condvln.instructions.counterfactuals import Group, counterfactual_group
from condvln.instructions.degeneracy import idle_conditions, is_circular, outcomes
from condvln.instructions.predicates import GROUP_OF, sayable
from condvln.instructions.priors import PriorBits
from condvln.instructions.programs import composition, instruction_id
from condvln.instructions.referents import ALTERNATIVES, Facts, Referents, object_refs, room_refs
from condvln.instructions.rejection import GivenUp
from condvln.instructions.rendering import word_count
from condvln.instructions.stop_sampler import DrawnStops, StopSampler
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


class _Names:
    """The names of one object, and the weights with which they are drawn.

    words : for each name, the labels that a word for an anchor of its qualifier might mean
    anchors : for each name, the labels of these anchors
    bearings : for each name, whether it is egocentric
    """

    def __init__(self, refs: Sequence[ObjectRef], sampling: SamplingConfig, words: Vocabulary) -> None:
        self.refs, self._sampling = refs, sampling
        self.anchors = [() if ref.qualifier is None else ref.qualifier.anchor_labels for ref in refs]
        self.bearings = [ref.is_bearing for ref in refs]
        self.words = [frozenset[str]().union(*map(words.overlapping, labels)) for labels in self.anchors]
        self._any_word = frozenset[str]().union(*self.words)
        self._sums = tuple(accumulate(preferences(refs, sampling)))

    def draw(self, said: Collection[str], draws: Draws) -> int:
        """Return the index of one of the names, by preference. No name relies on an object with a label that is `said`
        of another room.

        Raises
        ------
        GivenUp
            There is no such name.
        """
        if not self.refs:
            raise GivenUp("circular")
        if self._any_word.isdisjoint(said):
            return draws.cumulative(self._sums)
        left = [k for k, words in enumerate(self.words) if words.isdisjoint(said)]
        if not left:
            raise GivenUp("two_things")
        return draws.weighted(left, preferences([self.refs[k] for k in left], self._sampling))


def preferences(refs: Sequence[ObjectRef], sampling: SamplingConfig) -> list[float]:
    """Return the weights of `refs`, the names of one object, set by their predicates; a name of weight 0 is used only
    if the object has no other name.
    """
    groups = ["" if ref.qualifier is None else GROUP_OF[ref.qualifier.predicate] for ref in refs]
    weights = [getattr(sampling.predicates, group, 1.0) / groups.count(group) for group in groups]
    return weights if any(weights) else [1.0] * len(refs)


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
        self._known_names: dict[tuple[str, str | None, str, bool], _Names] = {}

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
            for stops in self._tries(reasons, shape, used, cap, draws):
                try:
                    program = self._draw(category, shape, stops, draws)
                    key = _unseen(program, seen)
                    self._worded(cell, program)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                    continue
                finally:
                    self._count_clashes(reasons)
                seen.add(key)
                found, failed = found + 1, 0
                used.update(leaf.goal.label for leaf in program.leaves)
                yield program
                break

    def _tries(
        self, rejected: Counter[str], shape: _Shape, used: Counter[str], cap: float, draws: Draws
    ) -> Iterator[DrawnStops]:
        """Yield rooms and stops for a candidate, again and again until there were as many draws as a candidate may
        take. Draws of stops that fail are added to `rejected`.
        """
        draw = self.stop_sampler.drawing(shape.composition, shape.moves, used, cap)
        left = self.sampling.draws_per_candidate
        while left > 0:
            reasons, stops = draw(left, draws)
            for reason, count in reasons.items():
                rejected[reason] += count
            if stops is None:
                return
            left -= sum(reasons.values()) + 1
            yield stops

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
            for stops in self._tries(reasons, shape, unused, self._most_goals(cell.category), draws):
                try:
                    program = self._draw(cell.category, shape, stops, draws)
                    _unseen(program, seen)
                    group = self._group(program, draws)
                except GivenUp as given_up:
                    reasons[given_up.reason] += 1
                    continue
                finally:
                    self._count_clashes(reasons)
                keys = set(map(_key, group))
                if not seen & keys:
                    seen.update(keys)
                    yield group
                    break

    def _count_clashes(self, rejected: Counter[str]) -> None:
        """Add the conditions of one draw that clashed with others to `rejected`."""
        for sampler in (self.condition_sampler, self._alone):
            if sampler.clashes:
                for rule, count in sampler.clashes.items():
                    rejected[rule] += count
                sampler.clashes.clear()

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

    def _draw(self, category: Category, shape: _Shape, found: DrawnStops, draws: Draws) -> Program:
        rooms, stops = found.rooms, found.leaves
        visited = [target for moves in stops for target in moves]
        names = self._room_names(rooms, visited, draws)
        near = [room for room in self.condition_sampler.start_rooms if room in names] if shape.bearings else []
        start_room = draws.choice(near) if near else None
        leaves, bearings = self._leaves(stops, names, draws, start_room)
        truths = draws.choice(_leading_to(category, shape.gold))
        moves = [move for leaf in leaves for move in leaf]
        conditions = self._sampler_of(category).conditions(truths, moves, names, draws, start_room, bearings)
        goals = [leaf[-1].object_id for leaf in leaves]
        if len(set(goals)) < len(goals) and idle_conditions(category, goals):
            raise GivenUp("idle_condition")
        program = Program(
            category=category,
            conditions=conditions,
            branches=SHAPES[category].branches,
            leaves=tuple(Leaf(moves=tuple(leaf)) for leaf in leaves),
        )
        if composition(program) != shape.composition:
            raise GivenUp("composition_missed")
        return program

    def _leaves(
        self, stops: Sequence[Sequence[Target]], names: Mapping[str, RoomRef], draws: Draws, start_room: str | None
    ) -> tuple[list[list[ObjectRef]], int]:
        """Return the names of the stops of each leaf, and the number of egocentric statements left for conditions. An
        object has the same name in all leaves.
        """
        # Each additional egocentric statement leaves fewer starts. At least one is left for a condition.
        bearings = self.sampling.bearings
        said = {(target.room_id, target.label) for moves in stops for target in moves}
        said |= {(room_id, name.anchor_label) for room_id, name in names.items() if name.anchor_label is not None}
        one_room = len(names) == 1
        elsewhere: Collection[str] = ()
        named: dict[str, tuple[ObjectRef, bool]] = {}
        leaves: list[list[ObjectRef]] = []
        for moves in stops:
            refs: list[ObjectRef] = []
            for target in moves:
                ref, is_bearing = named.get(target.object_id, (None, False))
                if ref is None or (is_bearing and bearings < 2):
                    here = target.room_id == start_room and bearings > 1
                    known = self._names_of(target, names[target.room_id], start=here)
                    if not one_room:
                        elsewhere = {label for room_id, label in said if room_id != target.room_id}
                    k = known.draw(elsewhere, draws)
                    ref, is_bearing = named[target.object_id] = known.refs[k], known.bearings[k]
                    if not one_room:
                        said.update([(target.room_id, label) for label in known.anchors[k]])
                refs.append(ref)
                bearings -= is_bearing
            leaves.append(refs)
        return leaves, bearings

    def _is_plain(self, room_id: str) -> bool:
        """Return whether a room's label alone names it."""
        return self._names[room_id][0].anchor_label is None

    def _room_names(self, rooms: Sequence[str], visited: Sequence[Target], draws: Draws) -> dict[str, RoomRef]:
        """Return a name of each room. No name relies on an object with the label of a stop, or with a label in another
        room's name.
        """
        said = {target.label for target in visited}
        names: dict[str, RoomRef] = {}
        for room_id in rooms:
            free = [
                name
                for name in self._names[room_id]
                if name.anchor_label is None or not said & self.words.overlapping(name.anchor_label)
            ]
            if not free:
                raise GivenUp("circular")
            name = names[room_id] = draws.choice(free[:ALTERNATIVES])
            said |= {name.anchor_label} if name.anchor_label is not None else set()
        return names

    def _names_of(self, target: Target, room: RoomRef, *, start: bool) -> _Names:
        """Return the names of a target. An egocentric name is possible only if `start` is true: the start is in the
        target's room.
        """
        key = (room.room_id, room.anchor_id, target.object_id, start)
        names = self._known_names.get(key)
        if names is None:
            if key[:3] not in self._refs:
                refs = object_refs(self.referents[target.room_id], target.index, room)
                self._refs[key[:3]] = tuple(ref for ref in refs if not is_circular(ref, self.words))
            refs = tuple(ref for ref in self._refs[key[:3]] if start or not ref.is_bearing)
            names = self._known_names[key] = _Names(refs, self.sampling, self.words)
        return names


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

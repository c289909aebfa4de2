"""Fill a scene's pool of episodes: draw candidate programs as they are wanted and place them, within quotas and without
favouring a label.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import chain, zip_longest
from typing import Final, TypeAlias

from condvln.episodes.candidates import Candidate, CandidateSupply
from condvln.episodes.identity import colliding, content_hash, numeric_id
from condvln.episodes.looking import LookingPath, LookingPaths
from condvln.episodes.observability import FIRST_VIEW, Observation, Observer
from condvln.episodes.placing import Fit, Outlook, Placement, Placer, Rejected, Routes
from condvln.instructions.programs import excess_of_sent, oddness
from schemas.config import InstructionCell
from schemas.config.constants import DRAWN_PER_PLACE, FEW_LABELS_SLACK, KEPT_AT_LEAST, MOVES_OFF
from schemas.program import SHAPES, Category, Program

__all__ = [
    "EpisodePool",
    "MoveShares",
    "PooledEpisode",
    "allowed_share",
    "fill_pool",
    "most_leaves",
    "over_share",
]


def allowed_share(label_cap: float, labels: int) -> float:
    """Return the maximum share of leaves that one label may have, where `labels` is the number of different labels."""
    return max(label_cap, FEW_LABELS_SLACK / max(1, labels))


def most_leaves(share: float, leaves: int) -> int:
    """Return how many of ``leaves`` leaves may have the same label if the maximum share is ``share``. The number is
    rounded up, so that small sets are not dropped.
    """
    return math.ceil(share * leaves)


def over_share(units: Sequence[Sequence[Counter[str]]], label_cap: float) -> list[int]:
    """Return the indices of the units to drop, in the order of dropping, so that no label exceeds its share.

    Parameters
    ----------
    units : what is kept or dropped as a whole: for each of its episodes a counter of its leaves' labels
    """
    leaves = [sum(unit, Counter[str]()) for unit in units]
    total = sum(leaves, Counter[str]())
    share = allowed_share(label_cap, len(total))
    episodes = sum(map(len, units))
    floor = math.ceil(KEPT_AT_LEAST * episodes)
    left, dropped = set(range(len(units))), list[int]()
    best, fewest = math.inf, 0
    while total:
        label = max(sorted(total), key=lambda name: total[name])
        most = most_leaves(share, total.total())
        if total[label] <= most:
            return dropped
        if total[label] / total.total() < best:
            best, fewest = total[label] / total.total(), len(dropped)
        over = {name for name, count in total.items() if count > most}
        holding = [k for k in left if leaves[k][label] and episodes - len(units[k]) >= floor]
        if not holding:
            break
        # The unit with the most leaves of labels above their share is dropped first; the last one on ties.
        worst = max(holding, key=lambda k: (len(over & leaves[k].keys()), k))
        left.remove(worst)
        dropped.append(worst)
        episodes -= len(units[worst])
        total -= leaves[worst]
    return dropped[:fewest]


QUARTERS: Final = tuple(k * math.pi / 2 for k in range(4))
"""Yaw offsets tried for a start whose first view must show the evidence; they map compass points to compass points."""

PASSING: Final = frozenset({"quota_full", "gold_leaf_full", "truth_full", "label_over_cap", "program_placed"})
"""Rejection reasons that may no longer apply after other episodes are dropped."""


SENT_OFF: Final = 0.75
"""By how many more of the relations to whose anchor a scene's episodes send one may be true than by chance, or fewer
(as much as a single one in a chain of four leaves): placing finds the false ones more often, where something small is
on what is the goal.
"""

MoveShares: TypeAlias = Callable[[Category], tuple[Sequence[float], Sequence[float]]]
"""Returns the shares of leaves with 1, 2, … moves that are wanted of a category, and those that are drawn for that."""


@dataclass(frozen=True, eq=False, slots=True)
class PooledEpisode:
    """A placed candidate, with the looking path to its gold leaf and its observability."""

    candidate: Candidate
    placement: Placement
    looking: LookingPath | None = None
    observation: Observation | None = None

    @property
    def instruction_id(self) -> str:
        """Id of the instruction."""
        return self.candidate.instruction_id

    @property
    def program(self) -> Program:
        """The instruction's program."""
        return self.candidate.program


@dataclass
class EpisodePool:
    """The result for one scene: placed episodes in the order of their candidates, and the rejections.

    candidates : number of candidates by cell (counterfactual groups under None); each is placed or rejected exactly
        once
    """

    episodes: list[PooledEpisode] = field(default_factory=list)
    candidates: Counter[InstructionCell | None] = field(default_factory=Counter)
    rejections: Counter[tuple[InstructionCell | None, str]] = field(default_factory=Counter)
    examples: dict[tuple[InstructionCell | None, str], Candidate] = field(default_factory=dict)

    def reject(self, cell: InstructionCell | None, reason: str, example: Candidate, count: int = 1) -> None:
        """Count rejections of `count` candidates of a cell, and keep the first one of each cell and reason as an
        example.
        """
        self.rejections[cell, reason] += count
        self.examples.setdefault((cell, reason), example)

    def reject_collisions(self, scene_id: str) -> None:
        """Drop episodes whose id collides with that of another episode of the scene, together with their counterfactual
        groups.
        """
        hashes = [content_hash(scene_id, e.instruction_id, e.placement.start, e.placement.yaw) for e in self.episodes]
        lost = {self.episodes[k].instruction_id for k in colliding([numeric_id(name) for name in hashes], hashes)}
        groups = {e.candidate.group_id for e in self.episodes if e.instruction_id in lost} - {None}
        kept = []
        for episode in self.episodes:
            if episode.instruction_id in lost or episode.candidate.group_id in groups:
                self.reject(episode.candidate.cell, "id_collision", episode.candidate)
            else:
                kept.append(episode)
        self.episodes = kept

    @property
    def placed(self) -> Counter[InstructionCell | None]:
        """Number of placed episodes by cell; counterfactual groups under None."""
        return Counter(episode.candidate.cell for episode in self.episodes)


def fill_pool(
    supply: CandidateSupply,
    placer: Placer,
    cells: Sequence[InstructionCell],
    label_cap: float,
    names_compass: Callable[[Program], bool],
    observer: Observer | None = None,
    groups: int = 0,
    move_shares: MoveShares | None = None,
    looking: LookingPaths | None = None,
    purposeful: bool = False,
) -> EpisodePool:
    """Draw candidates and place them, until every cell has the wanted number of episodes or is exhausted.

    Within a cell no gold index gets more than its equal share, so that the position of a leaf carries no information.
    `label_cap` limits the share of leaves with one target label, as far as possible (``over_share``); episodes dropped
    for it make room for other candidates. The programs of a counterfactual group are placed together from one start,
    before all others, or not at all. A cell that stays short rejects no candidate as `quota_full`.

    Parameters
    ----------
    cells, groups : cells and number of counterfactual groups wanted of the scene
    names_compass : whether a program's text names the start heading
    observer : computes the observability; if None, none is recorded and no cell may ask for one
    looking : finds the looking paths; if None, none are asked for
    move_shares : wanted and drawn shares of leaves with 1, 2, … moves by category. Long routes are rejected more often,
        so those that a cell lacks are drawn, and its next candidate is always the one that brings the cell's leaves
        nearest to the wanted shares; None tries the candidates in order
    purposeful : of the candidates with the same moves, try those first whose parts have most to do with each other, and
        keep the truths even of relations to whose anchor one is sent
    """
    wanted = sum(cell.count * SHAPES[cell.category].leaves for cell in cells) + round(groups * supply.group_leaves)
    most_of_label = most_leaves(allowed_share(label_cap, supply.labels), wanted)
    filling = _Filling(supply, placer, groups, names_compass, observer, cells, move_shares, looking, purposeful)
    filling.fill(lambda _: most_of_label)
    filling.trim(label_cap)
    return filling.pool()


def _golds_of_each(cell: InstructionCell) -> int:
    """Return how many episodes of a cell may have the same gold leaf."""
    return -(-cell.count // SHAPES[cell.category].leaves)


class _Try:
    """Candidates that are placed together: a single one, or a counterfactual group (same leaves in different order).

    moves : how many leaves of the first of them have 1, 2, … moves, as sorted pairs
    refused : reason why they are not placed, so far; placement : that of the first of them, computed once
    looking : the looking path to the gold leaf of each of them, if asked for
    """

    def __init__(self, members: Sequence[Candidate]) -> None:
        self.members = members
        self.cell, self.count = members[0].cell, len(members)
        self.moves = _counted(members[0].moves)
        self.refused: str | None = None
        self.placement: Placement | None = None
        self.looking: list[LookingPath] = []

    @cached_property
    def programs(self) -> frozenset[Program]:
        """Their programs."""
        return frozenset(member.program for member in self.members)

    @cached_property
    def oddness(self) -> int:
        """How little the parts of the first of them have to do with each other."""
        return oddness(self.members[0].program)

    @cached_property
    def sent(self) -> float:
        """How many more of the relations of the first of them to whose anchor one is sent are true than by chance."""
        return excess_of_sent(self.members[0].program)

    @cached_property
    def has_leads(self) -> bool:
        """Whether they have leads."""
        return any(branch.lead is not None for branch in self.members[0].program.branches)

    @cached_property
    def gold(self) -> int:
        """Index of the gold leaf of the first of them."""
        return self.members[0].gold

    @cached_property
    def targets(self) -> Counter[str]:
        """Number of leaves by target label, of all of them."""
        return Counter([label for member in self.members for label in member.labels])

    def order(self, member: Candidate) -> list[int]:
        """Return where each leaf of one of them is among the leaves of the first one."""
        leaves = self.members[0].program.leaves
        return [leaves.index(leaf) for leaf in member.program.leaves]

    @property
    def labels(self) -> list[Counter[str]]:
        """Number of leaves by target label, of each of them."""
        return [Counter(member.labels) for member in self.members]


_Waiting: TypeAlias = dict[tuple[tuple[int, int], ...], list[_Try]]


@lru_cache(maxsize=4096)
def _counted(moves: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of a number of moves and the number of leaves that have it, ascending."""
    return tuple(sorted(Counter(moves).items()))


class _Filling:
    """Fills the cells one after the other.

    tries : all candidates drawn so far, in their order
    untried : of each cell those that wait for their turn, by how many of their leaves have 1, 2, … moves
    """

    def __init__(
        self,
        supply: CandidateSupply,
        placer: Placer,
        groups: int,
        names_compass: Callable[[Program], bool],
        observer: Observer | None,
        cells: Sequence[InstructionCell],
        move_shares: MoveShares | None,
        looking: LookingPaths | None,
        purposeful: bool,
    ) -> None:
        self._looking, self._purposeful = looking, purposeful
        self._supply, self._cells, self._move_shares = supply, cells, move_shares
        self._tries: list[_Try] = []
        self._untried: dict[InstructionCell | None, _Waiting] = {cell: {} for cell in (None, *cells)}
        self._moves: defaultdict[InstructionCell, Counter[int]] = defaultdict(Counter)
        self._group_moves: defaultdict[Category, Counter[int]] = defaultdict(Counter)
        self._free = Counter[Category]()
        for cell in cells:
            if cell.moves is None:
                self._free[cell.category] += cell.count
        self._placer, self._names_compass, self._observer = placer, names_compass, observer
        self._groups_wanted, self._groups = groups, 0
        self._taken: Counter[InstructionCell] = Counter()
        self._golds: defaultdict[InstructionCell, Counter[int]] = defaultdict(Counter)
        self._led: Counter[InstructionCell] = Counter()
        self._labels: Counter[str] = Counter()
        self._seen: set[Program] = set()
        self._changes, self._sent = 0, 0.0

    def fill(self, most_of_label: Callable[[_Try], int]) -> int:
        """Place groups, then candidates of each cell, and return how many were placed. `most_of_label` is how many
        leaves may have the same label once a candidate is placed.
        """
        placed = 0
        for cell in (None, *self._cells):
            for one in self._in_turn(cell):
                one.refused = self._turned_away(one, most_of_label(one)) or self._unplaceable(one)
                if one.refused is None:
                    self._count(one, 1)
                    placed += 1
        for waiting in self._untried.values():
            for one in chain.from_iterable(waiting.values()):
                one.refused = self._turned_away(one, most_of_label(one))
        return placed

    def trim(self, label_cap: float) -> None:
        """Drop episodes so that no label exceeds its share. Then place rejected candidates whose reason, such as a full
        quota, no longer applies, and others that are drawn in their place.
        """
        placed = [one for one in self._tries if one.refused is None]
        share = allowed_share(label_cap, len(self._labels))
        dropped = [placed[k] for k in over_share([one.labels for one in placed], label_cap)]
        for one in dropped:
            one.refused = "label_over_cap"
            self._count(one, -1)
        found = len(dropped)
        while found:
            self._untried = {cell: {} for cell in self._untried}
            for one in self._tries:
                if one.refused in PASSING:
                    self._wait(one)
            found = self.fill(lambda one: most_leaves(share, self._labels.total() + one.targets.total()))
        for one in dropped:  # a dropped episode keeps its reason, even if its quota is full by now
            if one.refused is not None:
                one.refused = "label_over_cap"

    def pool(self) -> EpisodePool:
        """Return the pool, with the observability of each episode."""
        pool = EpisodePool()
        for one in self._tries:
            pool.candidates[one.cell] += one.count
            if one.refused is not None:
                pool.reject(one.cell, one.refused, one.members[0], one.count)
                continue
            assert one.placement is not None
            for member, looking in zip_longest(one.members, one.looking):
                leaves = tuple(one.placement.leaves[k] for k in one.order(member))
                pool.episodes.append(PooledEpisode(member, replace(one.placement, leaves=leaves), looking))
        if self._observer is not None:
            observe = self._observer.observe
            pool.episodes = [replace(e, observation=observe(e.program, e.placement.outlook)) for e in pool.episodes]
        return pool

    def _turned_away(self, one: _Try, most_of_label: int) -> str | None:
        """Return the reason why the candidates in `one` are not wanted now, such as a full quota or a program that is
        already placed. Return None if they are wanted. The answer may change when other candidates are placed or
        dropped.
        """
        cell = one.cell
        if self._is_full(cell):
            return "quota_full"
        if cell is not None and one.has_leads and self._led[cell] >= self._supply.leads_of(cell):
            return "quota_full"
        if cell is not None and self._wants_leads_only(cell) and not one.has_leads:
            return "quota_full"
        if cell is not None and self._golds[cell][one.gold] >= _golds_of_each(cell):
            return "gold_leaf_full"
        if self._purposeful and cell is not None and abs(self._sent + one.sent) > max(SENT_OFF, abs(self._sent)):
            return "truth_full"
        if any(self._labels[label] + count > most_of_label for label, count in one.targets.items()):
            return "label_over_cap"
        if not self._seen.isdisjoint(one.programs):
            return "program_placed"
        return None

    def _wants_leads_only(self, cell: InstructionCell) -> bool:
        """Return whether a cell has no place for programs without leads, in a scene that may have some with leads."""
        return cell.leads == "with" and self._supply.leads_of(cell) > 0

    def _is_full(self, cell: InstructionCell | None) -> bool:
        """Return whether a cell has all of its episodes; for None, whether there are all counterfactual groups."""
        return self._groups >= self._groups_wanted if cell is None else self._taken[cell] >= cell.count

    def _in_turn(self, cell: InstructionCell | None) -> Iterator[_Try]:
        """Yield candidates of a cell (groups for None) until it is full or exhausted. Each next one is the one that
        brings the cell's shares of leaves with 1, 2 or 3 moves nearest to the wanted shares, given what the caller has
        placed so far. In case of a tie, it is the one whose numbers of moves occurred first in the cell.
        """
        alike, drawn_at = self._untried[cell], -1
        while not self._is_full(cell) and (alike or self._draw(cell)):
            nearest, changes = next(iter(alike)), self._changes
            if cell is not None and self._is_free(cell):
                distances = self._distances(cell)
                nearest = min(alike, key=distances)
                # What is left over from the last draws may have the wrong moves.
                if drawn_at != changes and distances(nearest) > MOVES_OFF**2:
                    drawn_at = changes
                    if self._draw(cell):
                        nearest = min(alike, key=distances)
            while changes == self._changes and nearest in alike:  # until the caller places one
                one = alike[nearest].pop(0)
                if not alike[nearest]:
                    del alike[nearest]
                yield one

    def _draw(self, cell: InstructionCell | None) -> bool:
        """Draw a group, or a few more candidates than a cell still needs. Return whether there are any."""
        found: list[Sequence[Candidate]]
        if cell is None:
            group = self._supply.group()
            found = [group] if group else []
        else:
            most, taken = _golds_of_each(cell), self._golds[cell]
            golds = [k for k in range(SHAPES[cell.category].leaves) for _ in range(most - taken[k])]
            count = math.ceil(DRAWN_PER_PLACE * (cell.count - self._taken[cell]))
            lacking, moves = self._supply.leads_of(cell) - self._led[cell], self._lacking(cell)
            drawn: list[Candidate] = []
            if lacking > 0:
                drawn = self._supply.more(cell, math.ceil(DRAWN_PER_PLACE * lacking), golds, moves, leads=True)
            if not drawn and not self._wants_leads_only(cell):
                drawn = self._supply.more(cell, count, golds, moves)
            found = [[one] for one in drawn]
        for members in found:
            one = _Try(members)
            self._tries.append(one)
            self._wait(one)
        return bool(found)

    def _wait(self, one: _Try) -> None:
        """Let a candidate wait for its turn, behind those that are no odder."""
        moves = one.moves if one.cell is not None and self._is_free(one.cell) else ()
        waiting = self._untried[one.cell].setdefault(moves, [])
        if self._purposeful:
            insort(waiting, one, key=lambda other: other.oddness)
        else:
            waiting.append(one)

    def _is_free(self, cell: InstructionCell) -> bool:
        """Return whether leaves of a cell have different numbers of moves, whose shares are wanted."""
        return self._move_shares is not None and cell.moves is None

    def _held(self, cell: InstructionCell) -> list[float]:
        """Return how many leaves with 1, 2, … moves a cell has, its part of those of the category's counterfactual
        groups included, which the cell makes up for.
        """
        assert self._move_shares is not None
        wanted, _ = self._move_shares(cell.category)
        part, grouped, own = cell.count / self._free[cell.category], self._group_moves[cell.category], self._moves[cell]
        return [own[n] + part * grouped[n] for n in range(1, len(wanted) + 1)]

    def _lacking(self, cell: InstructionCell) -> list[float] | None:
        """Return the shares of leaves with 1, 2, … moves to draw, so that a cell gets the wanted ones; None if any will
        do. What is rejected more often than other leaves is drawn more often.
        """
        if self._move_shares is None or not self._is_free(cell):
            return None
        (wanted, drawn), held = self._move_shares(cell.category), self._held(cell)
        leaves = sum(held) + SHAPES[cell.category].leaves * (cell.count - self._taken[cell])
        weights = [
            max(0.0, share * leaves - count) * often / share if share else 0.0
            for share, often, count in zip(wanted, drawn, held, strict=True)
        ]
        return [weight / sum(weights) for weight in weights] if any(weights) else list(drawn)

    def _distances(self, cell: InstructionCell) -> Callable[[Iterable[tuple[int, int]]], float]:
        """Return a function that says how far the leaves of a cell are from the wanted shares after leaves with given
        moves are added: the sum, over the numbers of moves, of squared numbers of leaves. Moves are pairs of a number
        of moves and a number of leaves.
        """
        assert self._move_shares is not None
        (shares, _), held = self._move_shares(cell.category), self._held(cell)

        def distance(moves: Iterable[tuple[int, int]]) -> float:
            counts = held.copy()
            for n, added in moves:
                if n <= len(counts):
                    counts[n - 1] += added
            leaves = sum(counts)
            return sum([(count - share * leaves) ** 2 for count, share in zip(counts, shares, strict=True)])

        return distance

    def _unplaceable(self, one: _Try) -> str | None:
        """Place all candidates in `one` from the same start, unless they are placed already. Return None, or the reason
        why they can't be placed. This reason is final.
        """
        if one.placement is not None:
            return None
        first, cell = one.members[0], one.cell
        compass = any(self._names_compass(member.program) for member in one.members)
        fit = None if cell is None else self._fit(cell, first.program)
        lengths = None if cell is None else cell.route
        try:
            one.placement = self._placer.place(
                first.program,
                first.instruction_id,
                compass=compass,
                fit=fit,
                lengths=lengths,
                members=[member.program for member in one.members],
                look=None if self._looking is None else partial(self._look, one),
            )
        except Rejected as rejected:
            return rejected.reason
        return None

    def _look(self, one: _Try, routes: Routes) -> None:
        """Find the looking paths of all candidates in `one`.

        Raises
        ------
        Rejected : a leaf has none
        """
        assert self._looking is not None, "looking paths are asked for"
        one.looking = []
        for member in one.members:
            objects, leaves = zip(*[(routes.objects[k], routes.leaves[k]) for k in one.order(member)], strict=True)
            own = replace(routes, objects=objects, leaves=leaves)
            one.looking.append(self._looking.path(member.program, own, member.gold))

    def _count(self, one: _Try, by: int) -> None:
        """Count the candidates in `one` towards the quotas (`by` = 1), or no longer count them (`by` = −1)."""
        self._changes += 1
        if one.cell is None:
            self._groups += by
            for n, count in one.moves:
                self._group_moves[one.members[0].program.category][n] += by * count * one.count
        else:
            self._taken[one.cell] += by
            self._led[one.cell] += by * one.has_leads
            self._golds[one.cell][one.gold] += by
            self._sent += by * one.sent
            for n, count in one.moves:
                self._moves[one.cell][n] += by * count
        if by > 0:
            self._labels += one.targets
            self._seen |= one.programs
        else:
            self._labels -= one.targets
            self._seen -= one.programs

    def _fit(self, cell: InstructionCell, program: Program) -> Fit | None:
        asked, observer = cell.observability, self._observer
        if asked is None:
            return None
        assert observer is not None, "a cell asks for an observability, but no observer was given"
        # Turning would falsify statements about left and right.
        turns = QUARTERS if asked == FIRST_VIEW and program.start_room is None else QUARTERS[:1]

        def fit(outlook: Outlook) -> float | None:
            for turn in turns:
                yaw = math.remainder(outlook.yaw + turn, 2 * math.pi)
                if observer.observe(program, replace(outlook, yaw=yaw)).fits(asked):
                    return yaw
            return None

        return fit

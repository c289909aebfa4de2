"""Draw the candidates of a cell: the shape of each, then programs of that shape until one is new."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined, register_warm_up
from condvln.instructions.kernels.conditions import NOTHING, RULES, StatementTables
from condvln.instructions.kernels.programs import (
    COMPOSITION_MISSED,
    DUPLICATE,
    FITS,
    MOST_ANCHORS,
    REASONS,
    DrawnProgram,
    NameTables,
    ProgramSpace,
    WantedProgram,
    draw_program,
    program_space,
)
from condvln.instructions.kernels.stops import (
    MOST_MOVES,
    NO_TARGETS,
    NO_WAYPOINT,
    ByLabel,
    Questions,
    TargetTables,
    WantedStops,
    targets_fit,
)
from condvln.instructions.kernels.stream import cumulative, index
from condvln.uncounted import keep, uncounted
from schemas.config.constants import MOST_ROOMS

__all__ = [
    "FAILED",
    "FAILED_BEFORE",
    "FOUND",
    "GOLDS",
    "LEFT",
    "LEFT_BEFORE",
    "SEEN",
    "SHAPES_LEFT",
    "CellState",
    "FoundCandidates",
    "WantedCell",
    "cell_state",
    "draw_candidates",
    "found_candidates",
]

Doubles = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

SHAPES_LEFT: Final = 0
FAILED: Final = 1
FAILED_BEFORE: Final = 2
LEFT: Final = 3
LEFT_BEFORE: Final = 4
FOUND: Final = 5
SEEN: Final = 6
GOLDS: Final = 7
GOLD: Final = 8
COMPOSITION: Final = 9


class WantedCell(NamedTuple):
    """What is wanted of the candidates of a cell. Their programs have n leaves, b branches and b conditions.

    compositions (k,), composition_sums (k,) : the possible compositions by number, and their running weights; without
        weights, the only composition there is
    spans (3, 2) : least and most rooms of a program of each composition
    kinds : number of types of rooms
    roomy (3, r), roomy_sums (3, r), roomy_sizes (3,) : the rooms that have targets for all leaves, for at most 0, 1 and
        2 waypoints, their running weights, and how many they are
    move_sums (m,) : running shares of leaves with 1, 2, … moves; `moves` : number of moves of all leaves instead, or 0
    golds (g,) : the gold leaves of the next g candidates, which are dealt in a random order, again and again
    truths (n, a, b), truth_sizes (n,) : rows of truths of conditions that lead to each leaf, and how many they are
    asked (b,), below (b, 2, n) : the condition of each branch, and the leaves below THEN and ELSE
    cap : a label is a goal at most so often
    draws : most draws of a candidate
    vain : after so many consecutive shapes that gave no candidate, the cell is exhausted
    bearings, egocentric, attempts : see `WantedProgram`
    """

    compositions: Longs
    composition_sums: Doubles
    spans: Longs
    kinds: int
    roomy: Longs
    roomy_sums: Doubles
    roomy_sizes: Longs
    move_sums: Doubles
    moves: int
    golds: Longs
    truths: Bools
    truth_sizes: Longs
    asked: Longs
    below: Bools
    cap: float
    draws: int
    vain: int
    bearings: int
    egocentric: bool
    attempts: int


class CellState(NamedTuple):
    """How far the drawing of a cell has come. `draw_candidates` goes on from there.

    numbers (10,) : how many shapes are left; how many failed since the last candidate, and before that; how many draws
        the present shape has left (0: a new shape is drawn), and had when its candidate was found; how many candidates
        were found; how many keys were seen; how many golds are left; gold leaf and composition of the present shape
    golds (g,) : the golds that are left, the last of them is next; with room for those of the cell
    moves (n,) : number of moves of each leaf in the present shape
    used (l,) : how often each label is a goal so far
    keys (s, k) : keys of the candidates so far; empty if candidates may be equal
    """

    numbers: Longs
    golds: Longs
    moves: Longs
    used: Longs
    keys: Longs


def cell_state(shapes: int, leaves: int, used: Longs, keys: Longs, seen: int) -> CellState:
    """Return the state in which nothing is drawn, except that `seen` of the `keys` were seen before."""
    numbers = np.zeros(10, np.int64)
    numbers[SHAPES_LEFT], numbers[SEEN] = shapes, seen
    return CellState(numbers, np.zeros(leaves, np.int64), np.zeros(leaves, np.int64), used, keys)


class FoundCandidates(NamedTuple):
    """What `draw_candidates` writes to, for c candidates.

    failures (9,), clashes (7,) : to which the failed draws are added by their reason, and the violations of each rule
    moves (c, n) : number of moves of each leaf
    golds (c,) : the gold leaf
    rooms, room_names, stops, names, truths, conditions : (c, …), see `DrawnProgram`
    """

    failures: Longs
    clashes: Longs
    moves: Longs
    golds: Longs
    rooms: Longs
    room_names: Longs
    stops: Longs
    names: Longs
    truths: Longs
    conditions: Longs


def found_candidates(count: int, leaves: int, conditions: int) -> FoundCandidates:
    """Return what so many candidates are written to."""
    return FoundCandidates(
        failures=np.zeros(len(REASONS), np.int64),
        clashes=np.zeros(len(RULES), np.int64),
        moves=np.zeros((count, leaves), np.int64),
        golds=np.zeros(count, np.int64),
        rooms=np.zeros((count, 1 + MOST_ROOMS), np.int64),
        room_names=np.zeros((count, MOST_ROOMS), np.int64),
        stops=np.zeros((count, leaves, MOST_MOVES), np.int64),
        names=np.zeros((count, leaves, MOST_MOVES), np.int64),
        truths=np.zeros((count, 1), np.int64),
        conditions=np.zeros((count, conditions, 3), np.int64),
    )


@inlined
def _draw_shape(cell: WantedCell, state: CellState, stream: Doubles, left: Longs) -> int:
    """Draw the gold leaf, the composition and the moves of a candidate, and write them to `state`. Return the number of
    the reason why no program has this shape, or FITS.
    """
    numbers, n = state.numbers, len(state.moves)
    # By default, each leaf is gold as often as the others: placing takes no more of one than of another.
    if numbers[GOLDS] == 0:
        count = len(cell.golds)
        pool = np.empty(count, np.int64)
        for k in range(count):
            pool[k] = cell.golds[k]
        for k in range(count):
            place = index(count - k, stream, left)
            state.golds[k] = pool[place]
            for later in range(place, count - k - 1):
                pool[later] = pool[later + 1]
        numbers[GOLDS] = count
    numbers[GOLDS] -= 1
    numbers[GOLD] = state.golds[numbers[GOLDS]]
    there = len(cell.compositions) > 0
    if there:
        place = 0
        if len(cell.composition_sums) > 0:
            place = cumulative(cell.composition_sums, 0, len(cell.composition_sums), stream, left)
        numbers[COMPOSITION] = cell.compositions[place]
    most = 0
    for leaf in range(n):
        state.moves[leaf] = cell.moves
        if cell.moves == 0:
            state.moves[leaf] = 1 + cumulative(cell.move_sums, 0, len(cell.move_sums), stream, left)
        most = max(most, state.moves[leaf])
    if not there or cell.kinds < cell.spans[numbers[COMPOSITION], 0]:
        return NO_TARGETS
    if cell.spans[numbers[COMPOSITION], 1] == 1 and cell.roomy_sizes[most - 1] == 0:
        return NO_WAYPOINT if cell.roomy_sizes[0] > 0 else NO_TARGETS
    return FITS


@inlined
def _composition(cell: WantedCell, room_of: Longs, asked: Longs, moves: Longs, stops: Longs) -> int:
    """Return the number of a program's composition class; see ``condvln.instructions.programs.composition``.

    asked (b,) : room of each condition
    """
    n, goals = len(moves), np.empty(len(moves), np.int64)
    only, several = asked[0], False
    for room in asked:
        several |= room != only
    for leaf in range(n):
        for move in range(moves[leaf]):
            goals[leaf] = room_of[stops[leaf, move]]
            several |= goals[leaf] != only
    if not several:
        return 0
    for branch in range(len(cell.asked)):
        room, below, distinct = asked[cell.asked[branch]], cell.below[branch], True
        for leaf in range(n):
            distinct &= not ((below[0, leaf] or below[1, leaf]) and goals[leaf] == room)
            for other in range(n):
                distinct &= not (below[0, leaf] and below[1, other] and goals[leaf] == goals[other])
        if distinct:
            return 2
    return 1


@inlined
def _asked_rooms(one: DrawnProgram, names: NameTables, found: Longs) -> None:
    """Write to `found` (b, 3) each condition's room, the number of the room's name, and the statement's place."""
    for k in range(len(one.conditions)):
        count = 0
        for place in range(one.rooms[0]):
            room = one.rooms[1 + place]
            if names.asked[room]:
                if count == one.conditions[k, 0]:
                    found[k, 0], found[k, 1], found[k, 2] = room, one.room_names[place], one.conditions[k, 2]
                count += 1


@inlined
def _write_key(moves: Longs, conditions: Longs, names: Longs, same: Longs, key: Longs) -> None:
    """Write what distinguishes a program from the other programs of its category to `key`."""
    at = 0
    for k in range(len(conditions)):
        for column in range(3):
            key[at] = conditions[k, column]
            at += 1
    for leaf in range(len(moves)):
        for move in range(MOST_MOVES):
            key[at] = same[names[leaf, move]] if move < moves[leaf] else NOTHING
            at += 1


@inlined
def _is_among(key: Longs, keys: Longs, count: int) -> bool:
    for k in range(count):
        alike = True
        for column in range(len(key)):
            alike &= keys[k, column] == key[column]
        if alike:
            return True
    return False


@inlined
def _draw_candidates(
    most: int,
    cell: WantedCell,
    state: CellState,
    room_of: Longs,
    targets: TargetTables,
    names: NameTables,
    statements: StatementTables,
    space: ProgramSpace,
    stream: Doubles,
    left: Longs,
    found: FoundCandidates,
) -> None:
    numbers, moves, keys = state.numbers, state.moves, state.keys
    before, conditions = (
        np.empty(len(found.failures) + len(found.clashes), np.int64),
        np.empty((len(cell.asked), 3), np.int64),
    )
    reasons, asked = len(found.failures), np.empty(len(cell.asked), np.int64)
    key = np.empty(3 * len(cell.asked) + MOST_MOVES * len(moves), np.int64)
    while numbers[FOUND] < most:
        left[2] = left[0]
        if numbers[LEFT] == 0:
            if numbers[SHAPES_LEFT] == 0 or numbers[FAILED] >= cell.vain:
                return
            golds = numbers[GOLDS]
            reason = _draw_shape(cell, state, stream, left)
            if left[1]:
                numbers[GOLDS] = golds
                return
            numbers[SHAPES_LEFT] -= 1
            numbers[FAILED] += 1
            numbers[LEFT] = cell.draws
            if reason != FITS:
                found.failures[reason] += cell.draws
                numbers[LEFT] = 0
            continue
        before[:reasons], before[reasons:] = found.failures, found.clashes
        k, size, gold = numbers[FOUND], cell.roomy_sizes[moves.max() - 1], numbers[GOLD]
        rooms, waypoints = cell.spans[numbers[COMPOSITION]], moves.max() - 1
        stops = WantedStops(
            moves, rooms[0], rooms[1], cell.roomy[waypoints, :size], cell.roomy_sums[waypoints, :size], state.used,
            cell.cap,
        )  # fmt: skip
        wanted = WantedProgram(
            stops, cell.bearings, cell.egocentric, cell.truths[gold, : cell.truth_sizes[gold]], cell.attempts
        )
        one = DrawnProgram(
            found.failures, found.clashes, found.rooms[k], found.room_names[k], found.stops[k], found.names[k],
            found.truths[k], found.conditions[k],
        )  # fmt: skip
        failed = draw_program(numbers[LEFT], wanted, room_of, targets, names, statements, space, stream, left, one)
        if left[1]:
            found.failures[:], found.clashes[:] = before[:reasons], before[reasons:]
            return
        numbers[LEFT] -= failed
        if numbers[LEFT] == 0:
            continue
        numbers[LEFT] -= 1
        _asked_rooms(one, names, conditions)
        for condition in range(len(asked)):
            asked[condition] = conditions[condition, 0]
        if _composition(cell, room_of, asked, moves, one.stops) != numbers[COMPOSITION]:
            found.failures[COMPOSITION_MISSED] += 1
            continue
        if len(keys) > 0:
            _write_key(moves, conditions, one.names, names.same, key)
            if _is_among(key, keys, numbers[SEEN]):
                found.failures[DUPLICATE] += 1
                continue
            keys[numbers[SEEN]] = key
            numbers[SEEN] += 1
        for leaf in range(len(moves)):
            found.moves[k, leaf] = moves[leaf]
            state.used[targets.questions.label[one.stops[leaf, moves[leaf] - 1]]] += 1
        found.golds[k] = gold
        numbers[FOUND] += 1
        numbers[FAILED_BEFORE], numbers[FAILED] = numbers[FAILED], 0
        numbers[LEFT_BEFORE], numbers[LEFT] = numbers[LEFT], 0


@compiled
def draw_candidates(
    most: int,
    cell: WantedCell,
    state: CellState,
    room_of: Longs,
    targets: TargetTables,
    names: NameTables,
    statements: StatementTables,
    stream: Doubles,
    left: Longs,
    found: FoundCandidates,
) -> None:
    """Draw candidates until there are `most`, or the cell is exhausted, or the stream ends; in the latter case a call
    with a longer stream goes on (see ``condvln.instructions.kernels.stream``).

    room_of : (t,), the room of each target
    """
    space = program_space(len(state.moves), len(cell.asked), targets, names, statements)
    _draw_candidates(
        most, uncounted(cell), uncounted(state), uncounted(room_of), uncounted(targets), uncounted(names),
        uncounted(statements), uncounted(space), uncounted(stream), uncounted(left), uncounted(found),
    )  # fmt: skip
    keep(space)


def _warm_up() -> None:
    one, numbers, mask = np.ones(1), np.zeros(1, np.int64), np.ones((1, 1), bool)
    span, none = np.array([[0, 1]]), np.zeros((0, 2), np.int64)
    digests = np.zeros((1, 4), np.int64), np.zeros((1, 2), np.int64), np.zeros(1, bool)
    places = (numbers, one, numbers, numbers, mask[0])
    questions, by_label = Questions(mask, numbers, *digests), ByLabel(mask[0], numbers, span)
    targets = TargetTables(questions, by_label, mask, numbers, one, mask, mask, *places)
    targets_fit(mask[0], mask[0], 1, 0, questions)
    statements = StatementTables(
        overlap=np.zeros((1, 1), bool),
        sums=one,
        labels=numbers,
        anchors=np.full((1, 2), NOTHING),
        spans=np.array([[[0, 1], [0, 1]]]),
        presence=np.ones(1, bool),
        bearing=np.zeros(1, bool),
        pool_of_presence=numbers,
        share=one,
        groups=np.zeros((1, 2, 2), np.int64),
        group_sums=one,
        forms=none,
        form_sums=one,
        pool_of_form=numbers,
    )
    ends = np.array([0, 1])
    names = NameTables(
        room_first=ends,
        room_anchor=np.full(1, NOTHING),
        key_first=numbers,
        first=np.array([0, 1, 1]),
        sums=one,
        weight=one,
        group=numbers,
        anchors=np.full((1, MOST_ANCHORS), NOTHING),
        bearing=np.zeros(1, bool),
        same=numbers,
        label=numbers,
        statement_room=numbers,
        asked=np.ones(1, bool),
        start=np.zeros(1, bool),
    )
    cell = WantedCell(
        compositions=numbers,
        composition_sums=one,
        spans=np.ones((3, 2), np.int64),
        kinds=1,
        roomy=np.zeros((3, 1), np.int64),
        roomy_sums=np.ones((3, 1)),
        roomy_sizes=np.ones(3, np.int64),
        move_sums=one,
        moves=0,
        golds=numbers,
        truths=np.ones((1, 1, 1), bool),
        truth_sizes=np.ones(1, np.int64),
        asked=numbers,
        below=np.ones((1, 2, 1), bool),
        cap=1.0,
        draws=1,
        vain=1,
        bearings=0,
        egocentric=False,
        attempts=1,
    )
    state = cell_state(1, 1, numbers, np.zeros((1, 3 + MOST_MOVES), np.int64), 0)
    stream, left = np.zeros(64), np.array([64, 0, 64])
    draw_candidates(1, cell, state, numbers, targets, names, statements, stream, left, found_candidates(1, 1, 1))


register_warm_up("candidates", _warm_up)

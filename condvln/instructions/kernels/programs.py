"""Draw whole programs: rooms and stops, their names, and conditions. Rooms, targets, labels and names are numbers."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.instructions.kernels.conditions import CLAIM, NOTHING, Given, StatementTables, draw_conditions
from condvln.instructions.kernels.stops import (
    FAILURES,
    MOST_MOVES,
    StopSpace,
    TargetTables,
    WantedStops,
    draw_stops,
    prepare_stops,
    stop_space,
)
from condvln.instructions.kernels.stream import cumulative, index
from condvln.instructions.referents import ALTERNATIVES
from schemas.config.constants import PLAIN_ROOM_WEIGHT

__all__ = [
    "COMPOSITION_MISSED",
    "DUPLICATE",
    "REASONS",
    "DrawnProgram",
    "NameTables",
    "ProgramSpace",
    "WantedProgram",
    "draw_program",
    "program_space",
]

Doubles = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Bytes = npt.NDArray[np.int8]

REASONS: Final = (*FAILURES, "circular", "two_things", "no_condition", "composition_missed", "duplicate")
"""Why a draw failed, by number."""

FITS: Final = -1
"""In place of a reason: the draw did not fail."""

CIRCULAR: Final = len(FAILURES)
TWO_THINGS: Final = CIRCULAR + 1
NO_CONDITION: Final = CIRCULAR + 2
COMPOSITION_MISSED: Final = CIRCULAR + 3
DUPLICATE: Final = CIRCULAR + 4

MOST_ANCHORS: Final = 2
"""Most anchors of a name."""


class NameTables(NamedTuple):
    """The names of r rooms and t targets. Rooms and targets are numbered as in `TargetTables`; labels, and rooms in
    `statement_room`, as in `StatementTables`.

    room_first (r + 1,) : first name of each room; room_anchor (n,) : label in each room name, or NOTHING
    key_first (t,) : the names of target t, in a room with name number k, are those of key ``2 * (key_first[t] + k)``;
        of the next key if egocentric names are possible
    first (k + 1,) : first name of each key
    sums, weight (m,) : running weights of a key's names; weight of each name's group of predicates
    group (m,) : each name's group of predicates
    anchors (m, 2) : labels of each name's anchors, or NOTHING
    bearing (m,) : the name is egocentric
    same (m,) : the first name that is the same object of Python
    label (t,) : label of each target
    statement_room (r,) : each room's number in the statements
    asked (r,), start (r,) : conditions can be asked about the room; egocentric ones, if the start is there
    """

    room_first: Longs
    room_anchor: Longs
    key_first: Longs
    first: Longs
    sums: Doubles
    weight: Doubles
    group: Longs
    anchors: Longs
    bearing: Bools
    same: Longs
    label: Longs
    statement_room: Longs
    asked: Bools
    start: Bools


class WantedProgram(NamedTuple):
    """What is wanted of a program.

    bearings : most egocentric statements
    egocentric : whether egocentric statements are possible
    truths (a, c) : the truths of conditions that lead to the gold leaf, one row of which is drawn
    attempts : most draws of a pool of statements, and most draws of a statement from it
    """

    stops: WantedStops
    bearings: int
    egocentric: bool
    truths: Bools
    attempts: int


class DrawnProgram(NamedTuple):
    """What `draw_program` writes to.

    failures (9,), clashes (7,) : to which the failed draws are added by their reason, and the violations of each rule
    rooms (1 + most,) : number of rooms, and the rooms; room_names (most,) : which of its names each room has
    stops (n, 3) : targets; names (n, 3) : their names
    truths (1,) : row of the truths; conditions (c, 3) : which of the rooms asked about, the pool and the place of each
    """

    failures: Longs
    clashes: Longs
    rooms: Longs
    room_names: Longs
    stops: Longs
    names: Longs
    truths: Longs
    conditions: Longs


class Said(NamedTuple):
    """Labels that a text has said, and their rooms, both (s,), and how many there are, (1,)."""

    rooms: Longs
    labels: Longs
    size: Longs


class ProgramSpace(NamedTuple):
    """Working memory of `draw_program`. Nothing in it is counted, and nothing is allocated while a program is drawn.

    names (m,), sums (m,) : names that may be drawn, and their running weights
    given_stops (., 2), things (., 2), pairs (., 3) : see `Given`
    asked (r, 2), asked_sums (r,) : the rooms that may be asked about, see `draw_conditions`
    claims (c + 1, 6), rules (s,) : see `draw_conditions`
    """

    stops: StopSpace
    said: Said
    names: Longs
    sums: Doubles
    given_stops: Longs
    things: Longs
    pairs: Longs
    asked: Longs
    asked_sums: Doubles
    claims: Longs
    rules: Bytes


@inlined
def program_space(
    leaves: int, conditions: int, targets: TargetTables, names: NameTables, statements: StatementTables
) -> ProgramSpace:
    """Return working memory for programs with a number of leaves and of conditions."""
    most, rooms = leaves * MOST_MOVES, len(targets.type_of)
    said = rooms + (1 + MOST_ANCHORS) * most
    return ProgramSpace(
        stop_space(len(names.label), len(targets.order), rooms, leaves),
        Said(np.empty(said, np.int64), np.empty(said, np.int64), np.zeros(1, np.int64)),
        np.empty(ALTERNATIVES + len(names.sums), np.int64),
        np.empty(ALTERNATIVES + len(names.sums)),
        np.empty((most, 2), np.int64),
        np.empty((most * (2 + MOST_ANCHORS), 2), np.int64),
        np.empty((most * MOST_ANCHORS, 3), np.int64),
        np.empty((rooms, 2), np.int64),
        np.empty(rooms),
        np.empty((conditions + 1, CLAIM), np.int64),
        np.empty(len(statements.labels), np.int8),
    )


@compiled
def _say(room: int, label: int, said: Said) -> None:
    said.rooms[said.size[0]], said.labels[said.size[0]] = room, label
    said.size[0] += 1


@inlined
def _name_rooms(
    rooms: Longs,
    names: NameTables,
    overlap: Bools,
    said: Said,
    free: Longs,
    stream: Doubles,
    left: Longs,
    found: Longs,
) -> int:
    """Write the number of a name of each room to `found`. No name relies on an object with the label of a stop, or with
    a label in another room's name. Return the number of a reason, or FITS.
    """
    for k in range(len(rooms)):
        room, count = rooms[k], 0
        for name in range(names.room_first[room], names.room_first[room + 1]):
            anchor, clear = names.room_anchor[name], True
            if anchor >= 0:
                for s in range(said.size[0]):
                    clear &= not overlap[anchor, said.labels[s]]
            if clear and count < ALTERNATIVES:
                free[count] = name
                count += 1
        if count == 0:
            return CIRCULAR
        name = free[index(count, stream, left)]
        found[k] = name - names.room_first[room]
        if names.room_anchor[name] >= 0:
            _say(room, names.room_anchor[name], said)
    return FITS


@inlined
def _is_said_elsewhere(name: int, room: int, names: NameTables, overlap: Bools, said: Said) -> bool:
    """Return whether a word for an anchor of a name might mean something that the text names in another room."""
    found = False
    for column in range(MOST_ANCHORS):
        anchor = names.anchors[name, column]
        if anchor >= 0:
            for s in range(said.size[0]):
                found |= said.rooms[s] != room and overlap[anchor, said.labels[s]]
    return found


@inlined
def _draw_name(
    key: int,
    room: int,
    alone: bool,
    names: NameTables,
    overlap: Bools,
    space: ProgramSpace,
    stream: Doubles,
    left: Longs,
) -> int:
    """Return one of a key's names, by its weight, or, if there is none, −1 − the number of a reason. No name relies on
    an object with a label that was said of another room, unless the text names one room alone.
    """
    begin, end = names.first[key], names.first[key + 1]
    if begin == end:
        return -1 - CIRCULAR
    kept, sums, said, count = space.names, space.sums, space.said, 0
    for name in range(begin, end):
        if alone or not _is_said_elsewhere(name, room, names, overlap, said):
            kept[count] = name
            count += 1
    if count == 0:
        return -1 - TWO_THINGS
    if count == end - begin:
        return int(cumulative(names.sums, begin, end, stream, left))
    total = 0.0
    for k in range(count):
        alike = 0
        for other in range(count):
            alike += names.group[kept[other]] == names.group[kept[k]]
        total += names.weight[kept[k]] / alike
        sums[k] = total
    if total == 0.0:  # names of weight 0 are used only if there are no others
        for k in range(count):
            sums[k] = k + 1.0
    return int(kept[cumulative(sums, 0, count, stream, left)])


@inlined
def _name_stops(
    wanted: WantedProgram,
    rooms: Longs,
    start_room: int,
    room_of: Longs,
    names: NameTables,
    overlap: Bools,
    space: ProgramSpace,
    stream: Doubles,
    left: Longs,
    found: DrawnProgram,
) -> int:
    """Write the names of the stops of all leaves. An object has the same name in all leaves. Return the number of
    egocentric statements left for conditions, or, if there are no such names, −1 − the number of a reason.
    """
    # Each additional egocentric statement leaves fewer starts. At least one is left for a condition.
    bearings, alone, moves, said = wanted.bearings, len(rooms) == 1, wanted.stops.moves, space.said
    for leaf in range(len(moves)):
        for move in range(moves[leaf]):
            target, name = found.stops[leaf, move], NOTHING
            for other in range(leaf + 1):
                for k in range(move if other == leaf else moves[other]):
                    if found.stops[other, k] == target:
                        name = found.names[other, k]
            if name == NOTHING or (names.bearing[name] and bearings < 2):
                room, key = room_of[target], names.key_first[target]
                for k in range(len(rooms)):
                    if rooms[k] == room:
                        key += found.room_names[k]
                here = int(room == start_room and bearings > 1)
                name = _draw_name(2 * key + here, room, alone, names, overlap, space, stream, left)
                if name < 0:
                    return name
                for column in range(MOST_ANCHORS):
                    if names.anchors[name, column] >= 0:
                        _say(room, names.anchors[name, column], said)
            found.names[leaf, move] = name
            bearings -= int(names.bearing[name])
    return bearings


@inlined
def _presupposed(
    moves: Longs, rooms: Longs, room_of: Longs, names: NameTables, space: ProgramSpace, found: DrawnProgram
) -> Given:
    """Return what the phrases of all stops together presuppose."""
    stops, things, pairs = space.given_stops, space.things, space.pairs
    count = besides = related = 0
    for leaf in range(len(moves)):
        for move in range(moves[leaf]):
            target, name = found.stops[leaf, move], found.names[leaf, move]
            room, label = names.statement_room[room_of[target]], names.label[target]
            stops[count, 0], stops[count, 1] = room, label
            things[besides, 0], things[besides, 1] = room, label
            count, besides = count + 1, besides + 1
            for column in range(MOST_ANCHORS):
                anchor = names.anchors[name, column]
                if anchor >= 0:
                    things[besides, 0], things[besides, 1] = room, anchor
                    pairs[related, 0], pairs[related, 1], pairs[related, 2] = room, label, anchor
                    besides, related = besides + 1, related + 1
            for k in range(len(rooms)):
                anchor = names.room_anchor[names.room_first[rooms[k]] + found.room_names[k]]
                if rooms[k] == room_of[target] and anchor >= 0:
                    things[besides, 0], things[besides, 1] = room, anchor
                    besides += 1
    return Given(stops[:count], things[:besides], pairs[:related])


@compiled
def _finish(
    wanted: WantedProgram,
    room_of: Longs,
    names: NameTables,
    statements: StatementTables,
    space: ProgramSpace,
    stream: Doubles,
    left: Longs,
    found: DrawnProgram,
) -> int:
    """Draw names and conditions for rooms and stops. Return the number of a reason, or FITS."""
    rooms, moves, overlap = found.rooms[1 : 1 + found.rooms[0]], wanted.stops.moves, statements.overlap
    said = space.said
    said.size[0] = 0
    for leaf in range(len(moves)):
        for move in range(moves[leaf]):
            target = found.stops[leaf, move]
            _say(room_of[target], names.label[target], said)
    reason = _name_rooms(rooms, names, overlap, said, space.names, stream, left, found.room_names)
    if reason != FITS:
        return reason
    start_room, count = NOTHING, 0
    if wanted.egocentric:
        for room in rooms:
            count += names.start[room]
        if count > 0:
            # In the order of their numbers, whatever the order of the drawn rooms.
            place = index(count, stream, left)
            for room in range(len(names.start)):
                drawn = False
                for k in range(len(rooms)):
                    drawn |= rooms[k] == room
                if drawn and names.start[room]:
                    if place == 0:
                        start_room = room
                    place -= 1
    bearings = _name_stops(wanted, rooms, start_room, room_of, names, overlap, space, stream, left, found)
    if bearings < 0:
        return -1 - bearings
    found.truths[0] = index(len(wanted.truths), stream, left)
    asked, sums = space.asked, space.asked_sums
    count, total = 0, 0.0
    for k in range(len(rooms)):
        if names.asked[rooms[k]]:
            anchor = names.room_anchor[names.room_first[rooms[k]] + found.room_names[k]]
            asked[count, 0], asked[count, 1] = names.statement_room[rooms[k]], anchor
            # "If, in the bedroom that has the desk, the lamp …" is hard to follow: plain names are preferred.
            total += PLAIN_ROOM_WEIGHT if anchor < 0 else 1.0
            sums[count] = total
            count += 1
    given = _presupposed(moves, rooms, room_of, names, space, found)
    start = NOTHING if start_room == NOTHING else names.statement_room[start_room]
    if count == 0 or not draw_conditions(
        wanted.truths[found.truths[0]], asked[:count], sums[:count], start, bearings, wanted.attempts, given,
        statements, space.claims, space.rules, stream, left, found.clashes, found.conditions,
    ):  # fmt: skip
        return NO_CONDITION
    return FITS


@inlined
def draw_program(
    tries: int,
    wanted: WantedProgram,
    room_of: Longs,
    targets: TargetTables,
    names: NameTables,
    statements: StatementTables,
    space: ProgramSpace,
    stream: Doubles,
    left: Longs,
    found: DrawnProgram,
) -> int:
    """Draw a program until it fits, at most `tries` times. Return the number of tries that failed.

    room_of : (t,), the room of each target
    """
    failed, goal_labels = 0, prepare_stops(wanted.stops, targets, space.stops)
    while failed < tries and not left[1]:
        failed += draw_stops(
            tries - failed, wanted.stops, room_of, targets, goal_labels, space.stops, stream, left, found.failures,
            found.rooms, found.stops,
        )  # fmt: skip
        if failed < tries:
            reason = _finish(wanted, room_of, names, statements, space, stream, left, found)
            if reason == FITS:
                return failed
            found.failures[reason] += 1
            failed += 1
    return tries

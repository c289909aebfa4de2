"""Draw conditions that contradict neither each other nor the stops of a program. Labels and rooms are numbers here."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined, register_warm_up
from condvln.instructions.kernels.stream import cumulative, uniform
from condvln.uncounted import keep, uncounted

__all__ = [
    "CLAIM",
    "NOTHING",
    "RULES",
    "Given",
    "StatementTables",
    "draw_conditions",
    "leave_a_question",
    "rules_of_places",
]

Doubles = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Bytes = npt.NDArray[np.int8]

NOTHING: Final = -1
"""In place of a number: there is no anchor, no statements of presence, no rule that is violated."""

UNKNOWN: Final = -2
"""In place of a rule: it is not known yet whether one is violated."""

TAUTOLOGY: Final = 0
CIRCULAR: Final = 1
NAMES_STOP: Final = 2
GIVEN_AWAY: Final = 3
IMPLIED: Final = 4
ONE_LABEL: Final = 5
TWO_THINGS: Final = 6

RULES: Final = ("tautology", "circular", "names_stop", "given_away", "implied", "one_label", "two_things")
"""The rules of ``degeneracy.clash`` by their number."""

ROOM: Final = 0
ROOM_ANCHOR: Final = 1
LABEL: Final = 2
ANCHOR: Final = 3
OTHER_ANCHOR: Final = 4
PRESENCE: Final = 5
"""Columns of claims, see ``degeneracy.Claim``."""

CLAIM: Final = PRESENCE + 1
"""Number of columns of claims."""


class StatementTables(NamedTuple):
    """The statements about all rooms of a scene. Statements of one form about one room are a pool; a place is an index
    into the statements of all pools.

    overlap (l, l) : one word might name both labels
    sums (s,) : running sums of the weights of a pool's statements with one truth
    labels (s,), anchors (s, 2) : what a statement is about
    spans (p, 2, 2) : first place and end of a pool's statements, those with truth False and those with truth True
    presence (p,), bearing (p,) : the pool's statements are of presence, egocentric
    pool_of_presence (r,), share (r,) : a room's pool of presence, and how often it is used
    groups (r, 2, 2) : first group and end of a room's forms, without and with egocentric ones
    group_sums (g,), forms (g, 2) : running weights of a room's groups; a group's first form and end
    form_sums (f,), pool_of_form (f,) : running masses of a group's forms; their pools
    """

    overlap: Bools
    sums: Doubles
    labels: Longs
    anchors: Longs
    spans: Longs
    presence: Bools
    bearing: Bools
    pool_of_presence: Longs
    share: Doubles
    groups: Longs
    group_sums: Doubles
    forms: Longs
    form_sums: Doubles
    pool_of_form: Longs


class Given(NamedTuple):
    """What the phrases of stops presuppose, see ``degeneracy.Presupposed``.

    stops (s, 2), things (t, 2) : room and label
    pairs (p, 3) : room, label and label of the anchor
    """

    stops: Longs
    things: Longs
    pairs: Longs


@compiled
def clash(claims: Longs, k: int, given: Given, overlap: Bools) -> int:
    """Return the first rule that claim `k` violates together with the claims before it and the stops' phrases; NOTHING
    if it violates none. Same result as ``degeneracy.clash``.

    claims : (n, 6), see the columns above
    """
    room, room_anchor, label, presence = claims[k, ROOM], claims[k, ROOM_ANCHOR], claims[k, LABEL], claims[k, PRESENCE]
    if room_anchor >= 0 and overlap[label, room_anchor]:
        return TAUTOLOGY
    for column in range(ANCHOR, PRESENCE):
        if claims[k, column] >= 0 and overlap[label, claims[k, column]]:
            return TAUTOLOGY
    if room_anchor >= 0:
        for column in range(ANCHOR, PRESENCE):
            if claims[k, column] >= 0 and overlap[room_anchor, claims[k, column]]:
                return CIRCULAR
    for s in range(len(given.stops)):
        if (presence or given.stops[s, 0] == room) and overlap[label, given.stops[s, 1]]:
            return NAMES_STOP
    if presence:
        for s in range(len(given.things)):
            if overlap[label, given.things[s, 1]]:
                return GIVEN_AWAY
    for s in range(len(given.pairs)):
        if given.pairs[s, 0] == room:
            one, other = given.pairs[s, 1], given.pairs[s, 2]
            for column in range(ANCHOR, PRESENCE):
                anchor = claims[k, column]
                if anchor >= 0 and (
                    (overlap[label, one] and overlap[anchor, other]) or (overlap[anchor, one] and overlap[label, other])
                ):
                    return GIVEN_AWAY
    for o in range(k):
        if claims[o, ROOM] == room:
            if overlap[label, claims[o, LABEL]]:
                return IMPLIED
            for column in range(ANCHOR, PRESENCE):
                if presence and claims[o, column] >= 0 and overlap[label, claims[o, column]]:
                    return IMPLIED
                if claims[o, PRESENCE] and claims[k, column] >= 0 and overlap[claims[o, LABEL], claims[k, column]]:
                    return IMPLIED
    for o in range(k):
        if overlap[label, claims[o, LABEL]]:
            return ONE_LABEL
    if k > 0 and claims[k, ANCHOR] >= 0 and _closes_cycle(claims, k, overlap):
        return IMPLIED
    for column in range(ROOM_ANCHOR, PRESENCE):
        if claims[k, column] >= 0 and _is_elsewhere(claims[k, column], claims, k, given, overlap):
            return TWO_THINGS
    return NOTHING


@compiled
def _closes_cycle(claims: Longs, k: int, overlap: Bools) -> bool:
    """Return whether the relation of claim `k` closes a cycle of labels with the relations of the claims before it that
    are about the same room.

    It allocates, and is seldom needed: as a call of its own, `clash` need not.
    """
    made = np.empty(1 + 4 * k, np.int64)
    reached = uncounted(made)
    reached[0] = claims[k, LABEL]
    count, grown, closed = 1, True, False
    while grown:
        grown = False
        for o in range(k):
            if claims[o, ROOM] == claims[k, ROOM]:
                for column in range(ANCHOR, PRESENCE):
                    one, two = claims[o, LABEL], claims[o, column]
                    if two >= 0 and _any(reached, count, one, overlap) != _any(reached, count, two, overlap):
                        reached[count], reached[count + 1] = one, two
                        count += 2
                        grown = True
    for column in range(ANCHOR, PRESENCE):
        closed |= claims[k, column] >= 0 and _any(reached, count, claims[k, column], overlap)
    keep(made)
    return closed


@compiled
def _any(words: Longs, count: int, label: int, overlap: Bools) -> bool:
    """Return whether any of the first `count` of `words` might name `label`."""
    found = False
    for w in range(count):
        found |= overlap[words[w], label]
    return found


@inlined
def _is_elsewhere(label: int, claims: Longs, k: int, given: Given, overlap: Bools) -> bool:
    """Return whether a word of claim `k` might mean something that the text names in another room."""
    room = claims[k, ROOM]
    for s in range(len(given.things)):
        if given.things[s, 0] != room and overlap[label, given.things[s, 1]]:
            return True
    for o in range(k):
        if claims[o, ROOM] != room:
            for column in range(ROOM_ANCHOR, PRESENCE):
                if claims[o, column] >= 0 and overlap[label, claims[o, column]]:
                    return True
    return False


@compiled
def _claim(claims: Longs, k: int, room: int, room_anchor: int, pool: int, place: int, tables: StatementTables) -> None:
    """Write claim `k`: the statement at `place` of `pool`."""
    claims[k, ROOM], claims[k, ROOM_ANCHOR], claims[k, LABEL] = room, room_anchor, tables.labels[place]
    claims[k, ANCHOR], claims[k, OTHER_ANCHOR] = tables.anchors[place, 0], tables.anchors[place, 1]
    claims[k, PRESENCE] = tables.presence[pool]


@inlined
def _statements(room: int, start: int, tables: StatementTables, stream: Doubles, left: Longs) -> int:
    """Draw a pool of statements about a room; NOTHING if there is none. `start` is 1 if egocentric statements are
    possible there.
    """
    begin, end = tables.groups[room, start, 0], tables.groups[room, start, 1]
    presence = tables.pool_of_presence[room]
    if presence >= 0 and (uniform(stream, left) < tables.share[room] or begin == end):
        return int(presence)
    if begin == end:
        return NOTHING
    group = cumulative(tables.group_sums, begin, end, stream, left)
    form = cumulative(tables.form_sums, tables.forms[group, 0], tables.forms[group, 1], stream, left)
    return int(tables.pool_of_form[form])


@compiled
def draw_conditions(
    truths: Bools,
    rooms: Longs,
    room_sums: Doubles,
    start_room: int,
    bearings: int,
    attempts: int,
    given: Given,
    tables: StatementTables,
    claims: Longs,
    rules: Bytes,
    stream: Doubles,
    left: Longs,
    clashes: Longs,
    drawn: Longs,
) -> bool:
    """Draw one statement for each of `truths`, such that one of the other truth could be in its place. Return False if
    for some truth none was found.

    Parameters
    ----------
    rooms : (r, 2), numbers of the rooms that may be asked about, and the label in each room's name or NOTHING
    room_sums : (r,), their running weights
    bearings : most egocentric statements; they are about `start_room`
    attempts : most tries for a truth, each of one room, one form there, and one statement of that form
    claims, rules : (t + 1, 6) and (s,), working memory
    clashes : (7,), to which the violations of each rule are added
    drawn : (t, 3), set to the index in `rooms`, the pool and the place of each statement
    """
    for k in range(len(truths)):
        found = False
        rules[:] = UNKNOWN  # of each statement, until it is drawn
        for _ in range(attempts):
            r = cumulative(room_sums, 0, len(rooms), stream, left)
            room = rooms[r, 0]
            pool = _statements(room, int(room == start_room and bearings > 0), tables, stream, left)
            if pool < 0:
                continue
            # One draw of each truth: if statements that clash were drawn again, those with little weight would be asked
            # where the others are used up.
            for turn in range(2):
                begin, end = tables.spans[pool, 1 - turn, 0], tables.spans[pool, 1 - turn, 1]
                place = cumulative(tables.sums, begin, end, stream, left)
                if rules[place] == UNKNOWN:
                    _claim(claims, k, room, rooms[r, 1], pool, place, tables)
                    rules[place] = clash(claims, k, given, tables.overlap)
                found = rules[place] == NOTHING
                if not found:
                    clashes[rules[place]] += 1
                    break
                if truths[k] == (turn == 0):
                    drawn[k, 0], drawn[k, 1], drawn[k, 2] = r, pool, place
            if found:
                break
        if not found:
            return False
        _claim(claims, k, rooms[drawn[k, 0], 0], rooms[drawn[k, 0], 1], drawn[k, 1], drawn[k, 2], tables)
        bearings -= int(tables.bearing[drawn[k, 1]])
    return True


@compiled
def rules_of_places(
    claims: Longs, room: int, room_anchor: int, pool: int, truth: int, given: Given, tables: StatementTables
) -> Longs:
    """Return for each statement of a pool with the given `truth` the rule that it violates together with `claims` and
    the stops' phrases, or NOTHING.
    """
    tables, given, made = uncounted(tables), uncounted(given), np.empty((len(claims) + 1, CLAIM), np.int64)
    all_claims = uncounted(made)
    all_claims[: len(claims)] = claims
    begin, end = tables.spans[pool, truth, 0], tables.spans[pool, truth, 1]
    rules = np.empty(end - begin, np.int64)
    for place in range(begin, end):
        _claim(all_claims, len(claims), room, room_anchor, pool, place, tables)
        rules[place - begin] = clash(all_claims, len(claims), given, tables.overlap)
    keep(made)
    return rules


@compiled
def leave_a_question(
    claims: Longs, room: int, room_anchor: int, first: int, end: int, given: Given, tables: StatementTables
) -> bool:
    """Return whether some pool from `first` to `end` - 1 has a statement of either truth that violates no rule together
    with `claims` and the stops' phrases.
    """
    tables, given, made = uncounted(tables), uncounted(given), np.empty((len(claims) + 1, CLAIM), np.int64)
    all_claims, left = uncounted(made), False
    all_claims[: len(claims)] = claims
    for pool in range(first, end):
        sound = 0
        for truth in range(2):
            for place in range(tables.spans[pool, truth, 0], tables.spans[pool, truth, 1]):
                _claim(all_claims, len(claims), room, room_anchor, pool, place, tables)
                if clash(all_claims, len(claims), given, tables.overlap) < 0:
                    sound += 1
                    break
        if sound == 2:
            left = True
            break
    keep(made)
    return left


def _warm_up() -> None:
    none, one, place = np.zeros((0, 2), np.int64), np.ones(1), np.zeros(1, np.int64)
    span = np.array([[[0, 1], [0, 1]]])
    tables = StatementTables(
        overlap=np.zeros((1, 1), bool),
        sums=one,
        labels=place,
        anchors=np.full((1, 2), NOTHING),
        spans=span,
        presence=np.ones(1, bool),
        bearing=np.zeros(1, bool),
        pool_of_presence=place,
        share=one,
        groups=np.zeros((1, 2, 2), np.int64),
        group_sums=one,
        forms=none,
        form_sums=one,
        pool_of_form=place,
    )
    given = Given(none, none, np.zeros((0, 3), np.int64))
    rules_of_places(np.zeros((0, CLAIM), np.int64), 0, NOTHING, 0, 1, given, tables)
    leave_a_question(np.zeros((0, CLAIM), np.int64), 0, NOTHING, 0, 1, given, tables)


register_warm_up("conditions of programs", _warm_up)

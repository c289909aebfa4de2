"""Draw the rooms and the stops of a program. Rooms, labels and targets are numbers, sets of targets are masks."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, constant, inlined
from condvln.instructions.kernels.stream import cumulative, index
from condvln.uncounted import keep, uncounted

__all__ = [
    "FAILURES",
    "MOST_MOVES",
    "NO_TARGETS",
    "NO_WAYPOINT",
    "ByLabel",
    "Questions",
    "StopSpace",
    "TargetTables",
    "WantedStops",
    "draw_stops",
    "prepare_stops",
    "stop_space",
    "targets_fit",
]

Doubles = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

NONE: Final = -1
"""In place of a target: there is none."""

WITHOUT_WAYPOINTS: Final = constant(0)
"""In place of the number of waypoints, so that the kernel is not compiled again for a Python integer."""

NO_TARGETS: Final = 0
NO_WAYPOINT: Final = 1
LABEL_OVER_CAP: Final = 2
ONE_FIRST_STOP: Final = 3

FAILURES: Final = ("no_targets", "no_waypoint", "label_over_cap", "one_first_stop")
"""Why a draw failed, by number."""

MOST_MOVES: Final = 3
"""Most moves of a leaf."""

SEARCHED: Final = 500
"""Number of targets searched to find out whether a program fits, after which it counts as fitting."""

REJECTIONS: Final = 6
"""Number of labels drawn without checking before the remaining ones are counted; both give the same distribution."""


class Questions(NamedTuple):
    """What `fits` needs to know of a scene's t targets, and what it answered.

    apart (t, t) : see `stops.Target`
    label (t,) : the label of each target
    marks (t, 4) : random numbers, of which the digest of a set of targets is made
    digests (m, 2), answers (m,) : answers of `fits` by digest, m a power of two; kernels write to both
    """

    apart: Bools
    label: Longs
    marks: Longs
    digests: Longs
    answers: Bools


class ByLabel(NamedTuple):
    """The targets by their label.

    clear (t,) : see `stops.Target`
    members (t,), spans (l, 2) : the targets by label, ascending; where a label's targets begin and end
    """

    clear: Bools
    members: Longs
    spans: Longs


class TargetTables(NamedTuple):
    """The targets of a scene, t, their l labels, and the r rooms.

    A kernel that is called often gets a part of the tables only, since for each array of an argument the callee counts
    a reference.

    alike (t, t) : see `stops.Target`
    order (l,) : the labels in the order in which they are drawn from, weights (l,) : their weights in this order
    held (r, t) : the targets of each room
    spoiling (r, t) : the targets that leave nothing to ask about the room
    asked (a,), asked_sums (a,) : rooms about which conditions can be asked, and their running weights
    by_type (r,), type_of (r,) : the rooms, sorted by type; the type of each room
    plain (r,) : the room is named by its label alone
    """

    questions: Questions
    by_label: ByLabel
    alike: Bools
    order: Longs
    weights: Doubles
    held: Bools
    spoiling: Bools
    asked: Longs
    asked_sums: Doubles
    by_type: Longs
    type_of: Longs
    plain: Bools


class WantedStops(NamedTuple):
    """What is wanted of the stops of a program of n leaves.

    moves (n,) : number of moves of each leaf
    least, most : numbers of rooms; if `most` is 1, the room is one of `roomy` (k,), with running weights `roomy_sums`
    used (l,) : how often a label is a goal so far; a label is drawn more often the less it was used
    cap : a label is a goal at most so often
    """

    moves: Longs
    least: int
    most: int
    roomy: Longs
    roomy_sums: Doubles
    used: Longs
    cap: float


class StopSpace(NamedTuple):
    """Working memory of `draw_stops`. Nothing in it is counted, and nothing is allocated while stops are drawn.

    masks (13, t) : sets of targets, see the rows below
    labels (l,), weights (l,) : the labels that may be goals, and their weights
    sums (2 l,), waypoint_sums (2 l,) : for these labels and for all labels, see `_draw_target`
    ahead (r,) : rooms, goals (n,) : targets
    """

    masks: Bools
    labels: Longs
    weights: Doubles
    sums: Doubles
    waypoint_sums: Doubles
    ahead: Longs
    goals: Longs


HELD, DRAWABLE, BOTH, UNUSED, ALLOWED, FREE, REST, SPARE, APART, USED, OPEN, FRESH, CLEAR = range(13)
"""Rows of ``StopSpace.masks``."""


@inlined
def stop_space(targets: int, labels: int, rooms: int, leaves: int) -> StopSpace:
    """Return working memory for the stops of a scene's programs."""
    return StopSpace(
        np.empty((13, targets), np.bool_), np.empty(labels, np.int64), np.empty(labels), np.empty(2 * labels),
        np.empty(2 * labels), np.empty(rooms, np.int64), np.empty(leaves, np.int64),
    )  # fmt: skip


@compiled
def _count(mask: Bools) -> int:
    count = 0
    for k in range(len(mask)):
        count += mask[k]
    return count


@compiled
def _narrow(allowed: Bools, target: int, apart: Bools, found: Bools) -> None:
    """Set `found` to those of `allowed` that are apart from `target`."""
    for k in range(len(allowed)):
        found[k] = allowed[k] & apart[target, k]


@compiled
def _join(one: Bools, other: Bools, found: Bools) -> None:
    """Set `found` to what is in either set."""
    for k in range(len(one)):
        found[k] = one[k] | other[k]


@compiled
def _without_label(allowed: Bools, wanted: int, label: Longs) -> None:
    """Remove the targets whose label is `wanted` from `allowed`."""
    for k in range(len(allowed)):
        allowed[k] &= label[k] != wanted


@compiled
def _search(allowed: Bools, free: Bools, n: int, waypoints: int, apart: Bools, label: Longs) -> bool:
    """Return whether `allowed` contains `n` targets that have different labels and are pairwise apart, and `free`
    contains `waypoints` more such targets, also apart from the first `n`. One target after the other is tried; after
    `SEARCHED` targets, of the first `n` or of the others, the result is True.

    It allocates, and is seldom needed: as a call of its own, `fits` need not count references.
    """
    t, total = len(allowed), n + waypoints
    # Row d holds the targets that may still be tried as number d, and what is free for waypoints before it is chosen.
    masks, frees = np.empty((total, t), np.bool_), np.empty((n + 1, t), np.bool_)
    at, left = np.zeros(total + 1, np.int64), np.full(2, SEARCHED)
    frees[0] = free
    if total > 0:
        masks[0] = allowed if n > 0 else free
    depth = 0
    while 0 <= depth < total:
        of_waypoints = int(depth >= n)
        target = NONE
        if _count(masks[depth]) >= (total if of_waypoints else n) - depth:
            for k in range(at[depth], t):
                if masks[depth, k]:
                    target = k
                    break
        if target == NONE:
            depth -= 1
            continue
        masks[depth, target] = False  # every set with this target is searched now
        at[depth] = target + 1
        left[of_waypoints] -= 1
        if left[of_waypoints] < 0:
            return True
        depth += 1
        at[depth] = 0
        if depth <= n and waypoints > 0:
            _narrow(frees[depth - 1], target, apart, frees[depth])
        if depth == n and waypoints > 0:
            masks[depth], left[1] = frees[depth], SEARCHED
        elif depth < total:
            _narrow(masks[depth - 1], target, apart, masks[depth])
            _without_label(masks[depth], label[target], label)
    return depth >= 0


@compiled
def fits(allowed: Bools, free: Bools, n: int, waypoints: int, questions: Questions) -> bool:
    """Return whether `allowed` has targets for `n` leaves, and `free` more for the `waypoints` of the longest one.

    The answer is `_search`'s. It is kept, since draws ask again and again, until another question of the same place in
    the table overwrites it. Two questions with the same digest of 128 bits would get the same answer.
    """
    marks, digests, answers = questions.marks, questions.digests, questions.answers
    answer = n < 1 or _count(allowed) > 0
    if n > 1 or waypoints > 0:
        one, other = n, waypoints
        for k in range(len(allowed)):
            one ^= marks[k, 0] * allowed[k]
            other ^= marks[k, 1] * allowed[k]
        if waypoints > 0:
            for k in range(len(free)):
                one ^= marks[k, 2] * free[k]
                other ^= marks[k, 3] * free[k]
        place = one & (len(answers) - 1)
        if digests[place, 0] != one or digests[place, 1] != other:
            answers[place] = _search(allowed, free, n, waypoints, questions.apart, questions.label)
            digests[place, 0], digests[place, 1] = one, other
        answer = answers[place]
    return answer


@compiled
def targets_fit(allowed: Bools, free: Bools, n: int, waypoints: int, questions: Questions) -> bool:
    """Return `fits`, for callers in Python."""
    return fits(uncounted(allowed), uncounted(free), n, waypoints, uncounted(questions))


@compiled
def _draw_label(
    allowed: Bools, sums: Doubles, labels: Longs, members: Longs, spans: Longs, stream: Doubles, left: Longs
) -> int:
    """Return one of the labels that `allowed` targets have, by its weight, or NONE; see `_draw_target`.

    It allocates, and is seldom needed: as a call of its own, `_draw_target` need not count references.
    """
    there, made = np.empty(len(labels), np.int64), np.empty(len(labels))
    weights = uncounted(made)
    n, total = 0, 0.0
    for k in range(len(labels)):
        if _has(labels[k], allowed, members, spans):
            total += sums[len(labels) + k]
            there[n], weights[n] = labels[k], total
            n += 1
    label = NONE
    if n > 0:
        label = there[cumulative(weights, 0, n, stream, left)]
    keep(made)
    return label


@compiled
def _draw_target(
    allowed: Bools, sums: Doubles, labels: Longs, members: Longs, spans: Longs, stream: Doubles, left: Longs
) -> int:
    """Return one of the `allowed` targets, or NONE: first a label by its weight, then one of its targets uniformly.

    labels, sums : (n,), the labels that may be drawn and their running weights, see `_running`
    members, spans : see `ByLabel`
    """
    chosen = target = NONE
    if len(labels) > 0 and _count(allowed) > 0:
        for _ in range(REJECTIONS):
            one = labels[cumulative(sums, 0, len(labels), stream, left)]
            if _has(one, allowed, members, spans):
                chosen = one
                break
        if chosen == NONE:
            chosen = _draw_label(allowed, sums, labels, members, spans, stream, left)
    if chosen != NONE:
        begin, end = spans[chosen, 0], spans[chosen, 1]
        count = 0
        for k in range(begin, end):
            count += allowed[members[k]]
        place = index(count, stream, left)
        for k in range(begin, end):
            if allowed[members[k]]:
                if place == 0:
                    target = members[k]
                place -= 1
    return target


@compiled
def _draw_clear(
    allowed: Bools, sums: Doubles, labels: Longs, by_label: ByLabel, some: Bools, stream: Doubles, left: Longs
) -> int:
    """Return one of the `allowed` targets, if possible one with a clear name, or NONE; see `_draw_target`. `some` (t,)
    is working memory.
    """
    clear, members, spans = by_label.clear, by_label.members, by_label.spans
    for k in range(len(allowed)):
        some[k] = allowed[k] & clear[k]
    target = _draw_target(some, sums, labels, members, spans, stream, left)
    if target == NONE:
        target = _draw_target(allowed, sums, labels, members, spans, stream, left)
    return target


@compiled
def _has(label: int, allowed: Bools, members: Longs, spans: Longs) -> bool:
    """Return whether any of the `allowed` targets has this label."""
    found = False
    for k in range(spans[label, 0], spans[label, 1]):
        found |= allowed[members[k]]
    return found


@inlined
def _few_rooms(
    least: int,
    most: int,
    n: int,
    waypoints: int,
    tables: TargetTables,
    space: StopSpace,
    rooms: Longs,
    stream: Doubles,
    left: Longs,
) -> int:
    """Write `least` to `most` rooms of different types to `rooms`, which together have targets for all stops; return
    their number, or NONE. The row HELD is set to their targets.

    Conditions can be asked about the first room. The others are named by their label alone if enough such rooms are
    left, so that a text hardly ever has two rooms like "the bedroom with the piano".
    """
    held, both, ahead = space.masks[HELD], space.masks[BOTH], space.ahead
    rooms[0] = tables.asked[cumulative(tables.asked_sums, 0, len(tables.asked), stream, left)]
    held[:] = tables.held[rooms[0]]
    questions = tables.questions
    type_of, is_plain, by_type, held_by = tables.type_of, tables.plain, tables.by_type, tables.held
    count = 1
    while count < most:
        size = plain = 0
        for room in by_type:
            fresh = True
            for k in range(count):
                fresh &= type_of[rooms[k]] != type_of[room]
            if fresh:
                ahead[size] = room
                size += 1
                plain += is_plain[room]
        if size == 0 or (plain == 0 and count >= least and fits(held, held, n, waypoints, questions)):
            break
        if count == most - 1:
            kept = plain = 0
            for k in range(size):
                _join(held, held_by[ahead[k]], both)
                if fits(both, both, n, waypoints, questions):
                    ahead[kept] = ahead[k]
                    kept += 1
                    plain += is_plain[ahead[kept - 1]]
            if kept == 0:
                return NONE
            size = kept
        if plain > 0:
            place = index(plain, stream, left)
            for k in range(size):
                if is_plain[ahead[k]]:
                    if place == 0:
                        rooms[count] = ahead[k]
                        break
                    place -= 1
        else:
            rooms[count] = ahead[index(size, stream, left)]
        _join(held, held_by[rooms[count]], held)
        count += 1
    return count


@inlined
def _draw_goals(
    n: int,
    waypoints: int,
    sums: Doubles,
    labels: Longs,
    questions: Questions,
    by_label: ByLabel,
    space: StopSpace,
    stream: Doubles,
    left: Longs,
) -> int:
    """Write one goal for each of `n` leaves to ``space.goals``. They have different labels and are pairwise apart, and
    enough targets are left for the waypoints of the longest leaf. Return the number of a failure, or NONE.
    """
    masks, goals = space.masks, space.goals
    held, drawable, unused = masks[HELD], masks[DRAWABLE], masks[UNUSED]
    for k in range(len(held)):
        unused[k] = held[k] & drawable[k]
    if not fits(unused, unused, n, WITHOUT_WAYPOINTS, questions):
        return LABEL_OVER_CAP if fits(held, held, n, WITHOUT_WAYPOINTS, questions) else NO_TARGETS
    apart, label = questions.apart, questions.label
    allowed, free, rest, spare = masks[ALLOWED], masks[FREE], masks[REST], masks[SPARE]
    allowed[:], free[:] = unused, held
    count = 0
    while count < n:
        target = _draw_clear(allowed, sums, labels, by_label, masks[CLEAR], stream, left)
        if target == NONE:
            return NO_WAYPOINT if waypoints else NO_TARGETS
        _narrow(unused, target, apart, rest)
        _without_label(rest, label[target], label)
        _narrow(free, target, apart, spare)
        if fits(rest, spare, n - count - 1, waypoints, questions):
            goals[count] = target
            count += 1
            unused[:], free[:] = rest, spare
            allowed[:] = rest
        else:
            allowed[target] = False
    return NONE


@inlined
def _draw_moves(
    goal: int,
    count: int,
    masks: Bools,
    room_of: Longs,
    sums: Doubles,
    order: Longs,
    apart: Bools,
    label: Longs,
    by_label: ByLabel,
    stream: Doubles,
    left: Longs,
    moves: Longs,
) -> bool:
    """Write the stops of one leaf to `moves`: first `count` - 1 waypoints among those APART, then `goal`. The waypoints
    are apart from one another. The first waypoint is one of those USED, the stops with which other leaves begin, only
    if no other target is left. Return False if there are no such waypoints.
    """
    open_, fresh, used = masks[OPEN], masks[FRESH], masks[USED]
    open_[:] = masks[APART]
    _without_label(open_, label[goal], label)
    for k in range(count - 1):
        for other in range(len(open_)):
            fresh[other] = open_[other] & (k > 0 or not used[other])
        target = _draw_clear(fresh, sums, order, by_label, masks[CLEAR], stream, left)
        if target == NONE:
            target = _draw_clear(open_, sums, order, by_label, masks[CLEAR], stream, left)
        if target == NONE:
            return False
        moves[k] = target
        _narrow(open_, target, apart, open_)
        _without_label(open_, label[target], label)
    moves[count - 1] = goal
    if count == 3 and room_of[moves[0]] == room_of[goal] != room_of[moves[1]]:
        moves[0], moves[1] = moves[1], moves[0]  # stops never return to a room
    return True


@inlined
def _draw_leaves(
    counts: Longs,
    room_of: Longs,
    tables: TargetTables,
    space: StopSpace,
    stream: Doubles,
    left: Longs,
    stops: Longs,
) -> int:
    """Write the stops of all leaves to `stops`. Some leaves may begin with the same stop if no other stop is left, but
    never all leaves. Return the number of a failure, or NONE.
    """
    n, apart, label = len(counts), tables.questions.apart, tables.questions.label
    by_label, alike_to, order, sums = tables.by_label, tables.alike, tables.order, space.waypoint_sums
    masks, goals = space.masks, space.goals
    allowed, used = masks[APART], masks[USED]
    allowed[:], used[:] = masks[HELD], False
    for leaf in range(n):
        _narrow(allowed, goals[leaf], apart, allowed)
    for leaf in range(n):
        moves, count = stops[leaf], counts[leaf]
        if not _draw_moves(
            goals[leaf], count, masks, room_of, sums, order, apart, label, by_label, stream, left, moves
        ):
            return NO_WAYPOINT
        used[moves[0]] = True
        for k in range(counts[leaf] - 1):
            for other in range(len(allowed)):
                allowed[other] &= not alike_to[moves[k], other]
    for leaf in range(n):
        alike = 0
        for other in range(n):
            alike += stops[leaf, 0] == stops[other, 0]
        if alike > (n + 1) // 2:
            return ONE_FIRST_STOP
    return NONE


@compiled
def _running(weights: Doubles, n: int, sums: Doubles) -> None:
    """Write the running sums of the first `n` weights to `sums`, then the weights: what `_draw_target` takes."""
    total = 0.0
    for k in range(n):
        total += weights[k]
        sums[k], sums[n + k] = total, weights[k]


@inlined
def _leave_to_ask(rooms: Longs, spoiling: Bools, held: Bools) -> None:
    """Remove from `held` the targets that leave nothing to ask about any of the `rooms`."""
    for target in range(len(held)):
        spoils = True
        for room in rooms:
            spoils &= spoiling[room, target]
        held[target] &= not spoils


@inlined
def prepare_stops(wanted: WantedStops, tables: TargetTables, space: StopSpace) -> int:
    """Write the labels that may be goals, and the running weights of labels, to `space`. Return the number of these
    labels.
    """
    used, cap, order, preferred = wanted.used, wanted.cap, tables.order, tables.weights
    spans, members, drawable = tables.by_label.spans, tables.by_label.members, space.masks[DRAWABLE]
    drawable[:] = False
    kept = int(np.int64(0))  # not the literal 0, for whose value the kernels that get it would be compiled, too
    for k in range(len(order)):
        label = order[k]
        if used[label] + 1 <= cap:
            space.labels[kept] = label
            space.weights[kept] = preferred[k] / (1 + used[label])
            kept += 1
            for place in range(spans[label, 0], spans[label, 1]):
                drawable[members[place]] = True
    _running(space.weights, kept, space.sums)
    _running(preferred, len(order), space.waypoint_sums)
    return kept


@compiled
def draw_stops(
    tries: int,
    wanted: WantedStops,
    room_of: Longs,
    tables: TargetTables,
    goal_labels: int,
    space: StopSpace,
    stream: Doubles,
    left: Longs,
    failures: Longs,
    rooms: Longs,
    stops: Longs,
) -> int:
    """Draw rooms and the stops of all leaves until they fit, at most `tries` times. Return the number of tries that
    failed.

    Parameters
    ----------
    goal_labels, space : set by `prepare_stops`
    failures : (f,), to which the failed tries are added by their reason
    rooms : (1 + `most`,), set to the number of rooms and the rooms
    stops : (n, 3), set to the targets
    """
    counts, least, most, roomy, roomy_sums = wanted.moves, wanted.least, wanted.most, wanted.roomy, wanted.roomy_sums
    n, waypoints, held, held_by = len(counts), counts.max() - 1, space.masks[HELD], tables.held
    labels, sums = space.labels[:goal_labels], space.sums[: 2 * goal_labels]
    for attempt in range(tries):
        if left[1]:
            break  # the stream has ended
        if most == 1:
            rooms[0], rooms[1] = 1, roomy[cumulative(roomy_sums, 0, len(roomy), stream, left)]
            held[:] = held_by[rooms[1]]
        else:
            rooms[0] = _few_rooms(least, most, n, waypoints, tables, space, rooms[1:], stream, left)
            if rooms[0] == NONE:
                failures[NO_WAYPOINT if waypoints else NO_TARGETS] += 1
                continue
        _leave_to_ask(rooms[1 : 1 + rooms[0]], tables.spoiling, held)
        failed = _draw_goals(n, waypoints, sums, labels, tables.questions, tables.by_label, space, stream, left)
        if failed == NONE:
            failed = _draw_leaves(counts, room_of, tables, space, stream, left, stops)
        if failed == NONE:
            return attempt
        failures[failed] += 1
    return tries

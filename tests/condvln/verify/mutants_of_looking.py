"""Faults in looking paths. Each makes the path one that no honest agent could walk, or another than the actions walk.

A mutator changes the looking path of a row as its file has it, or says that it does not apply or would not change what
the path means: where the evidence is seen all the same, there is no fault. They are not among those of `mutants`, since
no other check than that of looking paths can notice them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mutation import Document, pick

from schemas.config.constants import STEP_CEILING

LEFT, RIGHT = 2, 3
LEAST_TURN = 0.6
"""Metres by which a corner that is left out lies off the shorter way, more than a walk may stray."""

LOOKING: dict[str, Callable[[Document, np.random.Generator], bool]] = {}
"""By its name, what puts one fault into a row; False where it does not apply."""


def _fault(function: Callable[[Document, np.random.Generator], bool]) -> None:
    LOOKING[function.__name__] = function


def _moved_frame(name: str, by: Callable[[int, np.random.Generator], int]) -> None:
    """One condition decided at another frame; only of one that is not decided at the start."""

    def mutate(row: Document, rng: np.random.Generator) -> bool:
        late = [k for k, frame in enumerate(row["looking_decided"]) if frame > 0]
        if not late:
            return False
        k = pick(rng, late)
        row["looking_decided"][k] = by(row["looking_decided"][k], rng)
        return True

    LOOKING[name] = mutate


_moved_frame("a_step_too_early", lambda frame, rng: frame - 1)
_moved_frame("a_step_too_late", lambda frame, rng: frame + 1)
_moved_frame("while_it_is_small", lambda frame, rng: int(rng.integers(max(frame - 4, 0), frame)))
_moved_frame("long_before", lambda frame, rng: int(rng.integers(frame)))
_moved_frame("before_the_start", lambda frame, rng: -1)


@_fault
def late_for_a_known_one(row: Document, rng: np.random.Generator) -> bool:
    """A condition that is known at the start, decided later."""
    early = [k for k, frame in enumerate(row["looking_decided"]) if frame == 0]
    if not early:
        return False
    row["looking_decided"][pick(rng, early)] = int(rng.integers(1, len(row["looking_actions"])))
    return True


@_fault
def another_order(row: Document, rng: np.random.Generator) -> bool:
    if len({*row["looking_decided"]}) == 1:
        return False
    before = list(row["looking_decided"])
    while row["looking_decided"] == before:
        rng.shuffle(row["looking_decided"])
    return True


@_fault
def a_decision_less(row: Document, rng: np.random.Generator) -> bool:
    row["looking_decided"].pop(int(rng.integers(len(row["looking_decided"]))))
    return True


@_fault
def a_decision_more(row: Document, rng: np.random.Generator) -> bool:
    row["looking_decided"].append(row["looking_decided"][-1])
    return True


@_fault
def the_direct_walk(row: Document, rng: np.random.Generator) -> bool:
    """The shortest walk to the gold leaf, by which the evidence is said to be seen as it is on the looking walk."""
    seen_by = max(row["looking_decided"])
    leaf = row["leaves"][row["gold_leaf"]]
    if row["direct_actions"][:seen_by] == row["looking_actions"][:seen_by]:
        return False
    row["looking_path"], row["looking_length"] = leaf["reference_path"], leaf["route_length"]
    row["looking_actions"] = row["direct_actions"]
    return True


@_fault
def a_glance_left_out(row: Document, rng: np.random.Generator) -> bool:
    """The last turn before the evidence is seen, and the turn back: the same way without the last piece of a look. The
    frames are counted as the shorter walk has them.
    """
    actions, decided = row["looking_actions"], row["looking_decided"]
    for at in sorted({frame for frame in decided if frame and actions[frame - 1] in (LEFT, RIGHT)}):
        back = at
        while back < len(actions) and actions[back] == actions[at - 1]:
            back += 1
        if back < len(actions) and actions[back] in (LEFT, RIGHT):
            row["looking_actions"] = [*actions[: at - 1], *actions[at:back], *actions[back + 1 :]]
            row["looking_decided"] = [frame - (frame >= at) - (frame > back) for frame in decided]
            return True
    return False


@_fault
def a_place_left_out(row: Document, rng: np.random.Generator) -> bool:
    """A corner that lies off the way between its neighbours; the length follows."""
    path = np.array(row["looking_path"])
    off = []
    for k in range(1, len(path) - 1):
        way, to = (path[k + 1] - path[k - 1])[[0, 2]], (path[k] - path[k - 1])[[0, 2]]
        part = np.clip(to @ way / max(way @ way, 1e-9), 0, 1)
        off.append(float(np.hypot(*(to - part * way))))
    far = [k + 1 for k, metres in enumerate(off) if metres > LEAST_TURN]
    if not far:
        return False
    del row["looking_path"][pick(rng, far)]
    _measure(row)
    return True


def _measure(row: Document) -> None:
    row["looking_length"] = float(np.linalg.norm(np.diff(row["looking_path"], axis=0), axis=1).sum())


@_fault
def another_length(row: Document, rng: np.random.Generator) -> bool:
    row["looking_length"] += float(rng.choice([-1, 1]) * rng.uniform(0.05, 2.0))
    return True


@_fault
def there_and_back(row: Document, rng: np.random.Generator) -> bool:
    """A path with a loop that the walk does not make, and as long as that."""
    path = row["looking_path"]
    at = int(rng.integers(len(path) - 1))
    if np.hypot(*(np.array(path[at]) - path[at + 1])[[0, 2]]) < 2 * LEAST_TURN:
        return False
    row["looking_path"] = [*path[: at + 2], path[at], *path[at + 1 :]]
    _measure(row)
    return True


@_fault
def another_end(row: Document, rng: np.random.Generator) -> bool:
    others = [leaf for leaf in row["leaves"] if leaf["leaf"] != row["gold_leaf"]]
    row["looking_path"][-1] = list(pick(rng, others)["goals"][0])
    _measure(row)
    return True


@_fault
def another_begin(row: Document, rng: np.random.Generator) -> bool:
    row["looking_path"][0][int(rng.choice([0, 2]))] += float(rng.choice([-0.3, 0.3]))
    _measure(row)
    return True


@_fault
def a_walk_cut_short(row: Document, rng: np.random.Generator) -> bool:
    """Its last steps, two thirds of all, are missing."""
    steps = [k for k, action in enumerate(row["looking_actions"]) if action == 1]
    row["looking_actions"] = [*row["looking_actions"][: steps[len(steps) // 3]], 0]
    return True


@_fault
def a_wrong_turn(row: Document, rng: np.random.Generator) -> bool:
    """A right angle more, with at least two metres to go."""
    steps = [k for k, action in enumerate(row["looking_actions"]) if action == 1]
    if len(steps) < 9:
        return False
    at = pick(rng, steps[:-8])
    row["looking_actions"][at:at] = [pick(rng, (LEFT, RIGHT))] * 6
    return True


@_fault
def the_back_to_the_goal(row: Document, rng: np.random.Generator) -> bool:
    row["looking_actions"][-1:] = [LEFT] * 12 + [0]
    return True


@_fault
def more_than_the_budget(row: Document, rng: np.random.Generator) -> bool:
    """Full turns at the end, until two thirds of the budget are used."""
    actions = row["looking_actions"]
    rounds = int(2 * STEP_CEILING / 3 - len(actions)) // 24 + 1
    row["looking_actions"] = [*actions[:-1], *[LEFT] * 24 * rounds, 0]
    return True


@_fault
def stopped_on_the_way(row: Document, rng: np.random.Generator) -> bool:
    row["looking_actions"].insert(int(rng.integers(len(row["looking_actions"]))), 0)
    return True


@_fault
def never_stopped(row: Document, rng: np.random.Generator) -> bool:
    row["looking_actions"].pop()
    return True


@_fault
def no_looking_path(row: Document, rng: np.random.Generator) -> bool:
    row[pick(rng, ("looking_path", "looking_length", "looking_actions", "looking_decided"))] = None
    return True

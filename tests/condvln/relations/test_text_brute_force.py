"""The predicates of text against plain loops over raw boxes, dead zones included."""

from __future__ import annotations

import sys
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from condvln.labels import vocabulary
from condvln.relations import relate_room, text_facts
from condvln.scene import RoomArrays
from schemas.config import Thresholds

sys.path.insert(0, str(Path(__file__).parent))
import brute_force as plain
from layered_rooms import grouped_room, layered_room

T = Thresholds()
PREDICATES = (
    "on",
    "under",
    "in",
    "near",
    "above",
    "below",
    "higher than",
    "lower than",
    "closest to",
    "between",
    "bigger",
    "far from",
    *plain.NORTH,
)


def check_room(seed: int, tally: Counter[tuple[str, int]]) -> None:
    """Every new predicate of every pair and triple of one room."""
    rng = np.random.default_rng(seed)
    arrays = RoomArrays.of("room", grouped_room(rng) if seed % 2 else layered_room(rng), 0.0)
    facts = text_facts(relate_room(arrays, T), T)
    boxes = [plain.box_of(item) for item in arrays.objects]
    chain, holders = plain.carried(boxes), plain.held(boxes)

    def rivals(a: plain.Box) -> list[plain.Box]:
        words = vocabulary.overlapping(a.label)
        return [
            b for b in boxes if b.name != a.name and (b.label in words or a.label in vocabulary.overlapping(b.label))
        ]

    rival = np.array([[b in rivals(a) for b in boxes] for a in boxes])
    closest, sizes = facts.closest(rival)[0], facts.sizes(rival)
    for i, a in enumerate(boxes):
        for j, b in enumerate(boxes):
            if i == j:
                continue
            expected = {
                "on": plain.on(a, b, boxes),
                "under": plain.under(a, b, 0),
                "in": plain.inside(a, b),
                "near": plain.near(a, b, boxes, holders),
                "above": plain.above(a, b, chain),
                "below": plain.above(b, a, chain),
                "higher than": plain.higher(a, b, 0, chain),
                "lower than": plain.higher(b, a, 0, chain),
            }
            expected |= {predicate: plain.beside(a, b, predicate) for predicate in plain.NORTH}
            if a.lo is not None and b.lo is not None:
                expected["far from"] = plain.far(a, b)
                assert facts.excluded["far from"][i, j] == plain.beside_it(a, b), (seed, a, b)
                tally["excluded", int(plain.beside_it(a, b))] += 1
            nearest = plain.closest(a, b, rivals(a))
            if (a.name, b.name) in holders or (b.name, a.name) in holders:
                nearest = min(nearest, 0)  # people say "on" or "in"
            assert closest[i, j] == nearest, (seed, a, b)
            tally["closest to", nearest] += 1
            for predicate in plain.NORTH:
                denied = facts.denied[predicate][i, j]
                assert denied == (plain.beside(a, b, predicate, loose=60) == -1), (seed, predicate, a, b)
                centres = plain.beside(a, b, predicate, whole=False)
                tally["undecided by a footprint", centres] += centres != expected[predicate]
                tally["denied", int(denied)] += 1
            if a.lo is not None and b.lo is not None and plain.grouped(a, b, boxes):
                far = all(plain.squared(p, q, (0, 2)) >= 2250 * 2250 for p in a.pieces for q in b.pieces)
                tally["far apart in one group", int(far)] += 1
            tally["near, of what holds the other", facts.status["near"][i, j]] += (a.name, b.name) in holders
            for predicate, status in expected.items():
                if status is None:
                    continue
                assert facts.status[predicate][i, j] == status, (seed, predicate, a, b)
                tally[predicate, status] += 1
                tally[f"{predicate}, of arms", status] += bool(a.parts or b.parts)
                tally[f"{predicate}, of what is said", status] += b.name in a.named
        for predicate, sign in (("bigger", 1), ("smaller", -1)):
            status = plain.bigger(a, rivals(a), rivals)
            assert sizes[predicate][i] == sign * status, (seed, predicate, a)
            tally[predicate, sign * status] += 1
    pairs = list(combinations(range(len(boxes)), 2))
    found, _ = facts.between(np.array(pairs))
    for k, (b, c) in enumerate(pairs):
        for i, a in enumerate(boxes):
            if i not in (b, c):
                status = plain.between(a, boxes[b], boxes[c], 0)
                assert found[i, k] == status, (seed, a, boxes[b], boxes[c])
                tally["between", status] += 1


def test_equal_to_plain_loops() -> None:
    tally: Counter[tuple[str, int]] = Counter()
    for seed in range(25):
        check_room(seed, tally)
    for predicate in PREDICATES:
        for status in (1, 0, -1):
            assert tally[predicate, status], f"no case of {predicate} is {status}"
    assert all(tally["undecided by a footprint", status] for status in (1, -1))
    assert tally["far apart in one group", 1]
    assert not tally["undecided by a footprint", 0], "a footprint makes no direction true or false"
    for predicate in ("on, of arms", "north-west of, of arms"):
        assert all(tally[predicate, status] for status in (1, 0, -1)), predicate
    assert all(tally["on, of what is said", status] for status in (1, 0))


@pytest.mark.soak
def test_equal_to_plain_loops_over_many_rooms() -> None:
    tally: Counter[tuple[str, int]] = Counter()
    for seed in range(1000, 1600):
        check_room(seed, tally)
    print(f"\n{sum(tally.values()):,} statements;", dict(sorted(tally.items())))
    pairs = sum(n for (predicate, _), n in tally.items() if predicate == "on")
    assert pairs >= 100_000
    for predicate in (*PREDICATES, "on, of arms", "above, of arms", "far from, of arms"):
        assert min(tally[predicate, status] for status in (1, 0, -1)) >= 20, predicate

"""Weights of statements that make neither label, anchor, nor predicate predict the truth.

From counts over rooms: a statement that is usually true is asked rarely where it is true, and as often where it is
false. Statements seen in a few rooms can't be balanced one by one; their labels can: the weights of a label's
statements are lowered for the truth that would be asked more often.

Within one room, for room types that are too rare for priors: iterative proportional fitting (Deming & Stephan 1940) of
the table of true statements and of the table of false ones towards the geometric mean of their marginals.

Over the stagings of a layout, and over all scenes of a family, counts of rooms are not enough. A statement that is true
in 97 of 100 rooms has a small weight where it is true, but each scene asks as much as any other, so that in a room
where all else has little weight too, it is asked all the same; and the stagings of a layout share their statements and
differ in few truths. So the expected draws of all rooms are computed, and one factor for each statement is fitted, by
which its weight is multiplied where it is true and divided where it is false (``condvln.instructions.expected_draws``).

The imbalance that is wanted is not 0 but a share of what fair coins would leave, since draws are not quite those that
are computed: some are rejected. Of which truth it is, a hash of the statement says, so that the imbalances of a label's
statements do not add up; in layouts of many stagings it is the truth that the statement has in more of them, since the
other would leave most draws to a few stagings. In programs of several conditions the share is smaller: conditions must
fit those before them, and so add an imbalance of their own.
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.instructions.absence import presence_asked
from condvln.instructions.expected_draws import (
    FACTOR_STEPS,
    ExpectedDraws,
    fitted_log_factors,
    hashed_signs,
    rounded_log_factors,
)
from condvln.instructions.predicates import GROUP_OF, PREDICATE_GROUPS, sayable
from condvln.instructions.statement_counts import (
    STATEMENT,
    CodedTexts,
    Statement,
    numbered,
    numbered_statements,
    of_each,
)
from condvln.labels import Vocabulary, vocabulary
from schemas.config import PlacesConfig, SamplingConfig
from schemas.config.constants import EVIDENCE, STAGINGS
from schemas.program import asked_in

__all__ = [
    "I32",
    "UNCHANGED",
    "ArrayFile",
    "ByConditions",
    "LabelForm",
    "RoomWords",
    "SceneRows",
    "balanced_weights",
    "family_log_factors",
    "informative_weights",
    "jointly_balanced_weights",
    "label_weights",
    "staging_factors",
    "statement_weights",
]

IN_MEMORY: Final = 1 << 22
"""Bytes up to which nothing is written to the disk."""

I32 = NDArray[np.int32]


class ArrayFile:
    """A list of tuples of arrays, which are read in the order in which they were appended, as often as wanted.

    width : number of arrays of a tuple
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._file: Any = tempfile.SpooledTemporaryFile(max_size=IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, _close, self._file)

    def append(self, *arrays: NDArray[np.integer[Any]]) -> None:
        """Append a tuple of (n,) arrays, each of its own length, whose values fit in 32 bits."""
        if len(arrays) != self._width:
            raise ValueError(f"{len(arrays)} arrays instead of {self._width}")
        self._file.seek(0, 2)
        self._file.write(np.array([len(one) for one in arrays], np.int64).tobytes())
        for one in arrays:
            self._file.write(one.astype(np.int32).tobytes())

    def __iter__(self) -> Iterator[tuple[I32, ...]]:
        """Yield each tuple."""
        at = 0
        while True:
            self._file.seek(at)
            lengths = np.frombuffer(self._file.read(8 * self._width), np.int64)
            if not len(lengths):
                return
            data = np.frombuffer(self._file.read(4 * int(lengths.sum())), np.int32)
            at = self._file.tell()
            yield tuple(np.split(data, np.cumsum(lengths)[:-1]))


def _close(file: Any) -> None:
    """Close a file. What could not be written to it is lost with it."""
    with suppress(OSError):
        file.close()


PSEUDOCOUNT: Final = 0.5
"""Added to both counts of a statement, so that few rooms don't count as certainty (Jeffreys' prior)."""

EXACT: Final = 2.0**30
"""Weights are added as whole multiples of 1 / EXACT, so that the sum does not depend on the order of rows."""

F64 = NDArray[np.float64]

LabelForm = tuple[str, str, str, bool]
"""Room type, label, predicate, whether statements about the label are definite."""


def informative_weights(n_true: int, n_false: int, evidence: int = EVIDENCE) -> dict[bool, float]:
    """Return the sampling weights of a statement, by truth, from the number of rooms in which it is true and the number
    in which it is false.

    True occurrences are weighted by the share of false ones and vice versa, so that over all rooms a statement is
    sampled as often true as false, and rarely if its truth hardly varies. Both weights are 0 if it did not vary in at
    least `evidence` rooms.
    """
    weights = statement_weights(np.array([[float(n_true), float(n_false)]]), evidence)
    return {truth: float(weights[truth][0]) for truth in (True, False)}


def statement_weights(counts: F64, evidence: int = EVIDENCE) -> dict[bool, F64]:
    """Return what `informative_weights` returns, of n statements, (n,). `counts` (n, 2) has the numbers of rooms in
    which each statement is true and in which it is false.
    """
    true, false = _weights(counts[:, 0], counts[:, 1], evidence)
    return {True: true, False: false}


def _weights(n_true: F64, n_false: F64, evidence: int) -> tuple[F64, F64]:
    total = n_true + n_false
    rate = (n_true + PSEUDOCOUNT) / (total + 2.0 * PSEUDOCOUNT)
    varies = (total < evidence) | (np.minimum(n_true, n_false) > 0)
    return np.where(varies, 1.0 - rate, 0.0), np.where(varies, rate, 0.0)


def label_weights(counts: pa.Table) -> dict[LabelForm, tuple[float, float]]:
    """Return, for each form of the statements about a label in a type of room, the factors by which the weights of its
    false and of its true statements are multiplied. With them, statements of this form are sampled as often true as
    false over all rooms; no factor is above 1.

    Parameters
    ----------
    counts : relational statements, with the columns ``n_true`` and ``n_false``; a statement may have several rows
    """
    sums = counts.group_by(list(STATEMENT)).aggregate([("n_true", "sum"), ("n_false", "sum")])
    n_true, n_false = (sums[name].to_numpy().astype(np.float64) for name in ("n_true_sum", "n_false_sum"))
    true, false = _weights(n_true, n_false, EVIDENCE)
    forms = {name: sums[name] for name in STATEMENT if name != "anchor"}
    exact = {
        name: np.rint(weight * EXACT).astype(np.int64)
        for name, weight in (("false", n_false * false), ("true", n_true * true))
    }
    drawn = pa.table({**forms, **exact}).group_by(list(forms))
    columns = drawn.aggregate([("false", "sum"), ("true", "sum")]).select([*forms, "false_sum", "true_sum"])
    return {
        (room_type, label, predicate, definite): _lowered(of_false, of_true)
        for room_type, label, predicate, definite, of_false, of_true in zip(*columns.to_pydict().values(), strict=True)
    }


def _lowered(of_false: int, of_true: int) -> tuple[float, float]:
    """Return a factor for each of the sums `of_false` and `of_true`, neither above 1, so that the scaled sums are
    equal. Both factors are 0 if either sum is 0.
    """
    less = min(of_false, of_true)
    return (less / of_false, less / of_true) if less > 0 else (0.0, 0.0)


BALANCING_ROUNDS: Final = 100
"""Iterations of proportional fitting; the marginals of real rooms converge to 1e-3 within about ten."""

LEAST_WEIGHT: Final = 1e-6
"""A cell whose weight falls below this share of the largest counts as excluded by the fitting."""

Bools = NDArray[np.bool_]


def balanced_weights(true: Bools, false: Bools) -> dict[bool, F64] | None:
    """Return, by truth, the weights of the cells of a (labels, anchors) table: those of the true cells and those of the
    false cells, with equal marginals.

    With these weights neither the label nor the anchor predicts whether the statement is true. Labels and anchors with
    only one truth are dropped. If nothing is left, only the labels are balanced; None if no label has both truths.
    """
    return _fitted(true, false, ((1, 0), (0,)))


def jointly_balanced_weights(true: Bools, false: Bools) -> dict[bool, F64] | None:
    """Return, by truth, the weights of the cells of a (forms, labels, anchors) table, with equal marginals.

    For forms of statements none of which can be balanced by itself: "the bowl north of the sink" is true and "the bowl
    east of the sink" false. With these weights neither the form, nor the label, nor the anchor predicts the truth, and
    each form that is left has both truths. If nothing is left, anchors are not balanced; None if nothing is left then
    either.
    """
    return _fitted(true, false, ((2, 0, 1), (0, 1)))


def _fitted(true: Bools, false: Bools, ways: Sequence[Sequence[int]]) -> dict[bool, F64] | None:
    """Return the weights by truth that balance the marginals of the axes that one of the `ways` lists; the first way
    counts that leaves any cell.
    """
    for kept in ways:
        cells = (true, false)
        while all(c.any() for c in cells):
            tables = _balanced(cells, kept)
            tables = [np.where(t < LEAST_WEIGHT * t.max(), 0.0, t) for t in tables]
            left = _with_both_truths(tables, kept)
            if all(c.any() for c in left) and all(np.array_equal(t > 0, c) for t, c in zip(tables, left, strict=True)):
                return {True: tables[0], False: tables[1]}
            cells = left  # a value that kept one truth would reveal it: the rest is fitted without it
    return None


def _balanced(cells: Sequence[Bools], kept: Sequence[int]) -> list[F64]:
    """Return weights of the true and of the false cells after proportional fitting along the `kept` axes."""
    tables = [c.astype(np.float64) for c in cells]
    for _ in range(BALANCING_ROUNDS):
        before = tables
        for axis in kept:
            others = tuple(k for k in range(tables[0].ndim) if k != axis)
            sums = [t.sum(axis=others, keepdims=True) for t in tables]
            target = np.sqrt(sums[0] * sums[1])
            tables = [
                t * np.divide(target, s, out=np.zeros_like(s), where=s > 0) for t, s in zip(tables, sums, strict=True)
            ]
        if all(map(np.array_equal, before, tables)):
            break  # further rounds would change nothing
    return tables


def _with_both_truths(tables: Sequence[F64], kept: Sequence[int]) -> tuple[Bools, Bools]:
    """Return masks of the cells with a weight whose value on each of the `kept` axes has weights of both truths."""
    true, false = (t > 0 for t in tables)
    for axis in kept:
        others = tuple(k for k in range(true.ndim) if k != axis)
        both = true.any(axis=others, keepdims=True) & false.any(axis=others, keepdims=True)
        true, false = true & both, false & both
    return true, false


class ByConditions(NamedTuple):
    """A value for programs of one condition, and one for programs of several."""

    one: float
    several: float


MANY_STAGINGS: Final = 10
"""Number of stagings from which a statement's imbalance goes to its usual truth; below it, a hash says of which truth
it is. In five stagings most statements are true in all but one, and a guesser that bets on the others is either always
right or always wrong: half of the statements must be of each kind."""

MANY_STAGINGS_IMBALANCE: Final = ByConditions(0.5, 0.4)
"""Share of the imbalance of fair coins that is wanted in layouts of many stagings: chosen by drawing ReplicaCAD's 21
stagings of two layouts. With 0.35 in programs of several conditions, betting against the truths of other stagings was
right 2 points above chance; with 0.45, betting on them as much; with 0.7 in programs of one, betting on them 6."""

FEW_STAGINGS_IMBALANCE: Final = ByConditions(1.15, 1.15)
"""The same in layouts of few stagings: chosen by drawing five stagings of each of 15 made apartments of RoboTHOR. With
1, betting against the truths of other stagings was right 6 points above chance; with 1.3, betting on them 3 points, and
betting on those of other layouts 7 (with 1.15, 4)."""

UNCHANGED: Final = ByConditions(1.0, 1.0)
"""The factors of a statement that is about no staging."""

PRESENCE: Final = ""
"""In place of a group of predicates."""


def staging_factors(
    counts: pa.Table, group_weights: Mapping[str, float], presence: float = 0.0
) -> dict[Statement, ByConditions]:
    """Return, by statement, the factors by which the weights of its true occurrences are multiplied, and those of its
    false ones divided.

    Parameters
    ----------
    counts : statements about the rooms of the stagings of one layout, with the columns of ``PRIORS``; the
        rooms of one type in one staging count as one room
    group_weights : weights of the groups of predicates; the statements of a group with weight 0 get the factor 1
    presence : share of conditions that are of presence, if their truths vary enough
    """
    if not counts.num_rows:
        return {}
    draws, statements, usual = _staging_draws(counts, group_weights, presence)
    many = len(pc.unique(counts["staging"])) >= MANY_STAGINGS
    layout = counts["layout"][0].as_py()
    signs = usual if many else hashed_signs([(layout, *statement) for statement in statements])
    shares = MANY_STAGINGS_IMBALANCE if many else FEW_STAGINGS_IMBALANCE
    log_factors = np.stack([fitted_log_factors((draws,), share * signs) for share in shares], axis=1)
    factors = np.exp2(rounded_log_factors(log_factors) / FACTOR_STEPS).tolist()
    return {statement: ByConditions(*own) for statement, own in zip(statements, factors, strict=True)}


def _staging_draws(
    counts: pa.Table, group_weights: Mapping[str, float], presence: float
) -> tuple[ExpectedDraws, list[Statement], F64]:
    """Return the expected draws; the statements by number; and for each statement 1 if it is true in more stagings than
    it is false in, else -1. Where the numbers are equal, the hash of the statement decides.
    """
    staging, *texts = (CodedTexts.of(counts[name]) for name in ("staging", *STATEMENT[:-1]))
    definite = counts["definite"].to_numpy()
    statement, statements = numbered_statements(texts, definite, np.arange(len(definite)))
    room_type, _, (named, predicate), _ = texts
    group_of: dict[str, str] = {PRESENCE: PRESENCE} | {str(name): group for name, group in GROUP_OF.items()}
    groups = [group_of[name] for name in named]
    room, _ = numbered(staging.numbers, room_type.numbers)
    form, _ = numbered(room, predicate, definite)
    group, _ = numbered(room, np.array([groups.index(name) for name in groups], np.int64)[predicate])
    seen = np.stack([counts[name].to_numpy().astype(np.float64) for name in ("n_false", "n_true")])
    n = len(statements)
    counted = np.stack([np.bincount(statement, side, n) for side in seen[::-1]], axis=1, dtype=np.float64)
    base = statement_weights(counted, STAGINGS)
    there = [np.flatnonzero(side) for side in seen]
    at = np.concatenate(there)
    truth = np.repeat([0, 1], [len(rows) for rows in there])
    more = np.bincount(statement[at], 2.0 * truth - 1.0, n)
    weights = np.array([group_weights.get(name, 0.0) for name in groups], np.float64)
    asked = np.array([presence if name == PRESENCE else 0.0 for name in groups])
    room_of_group = of_each(group, room)
    draws = ExpectedDraws(
        2 * statement[at] + truth,
        seen[truth, at] * np.stack([base[False], base[True]])[truth, statement[at]],
        form=form[at],
        group_of_form=of_each(form, group),
        room_of_group=room_of_group,
        scene_of_room=of_each(room, staging.numbers),
        group_weights=of_each(group, weights[predicate]),
        presence=of_each(group, asked[predicate]),
        room_weights=np.ones(int(room.max()) + 1),
    )
    return draws, statements, np.sign(np.where(more != 0, more, hashed_signs(statements)))


FAMILY_IMBALANCE: Final = 0.9
"""Share of the imbalance of fair coins that is wanted. With 0, betting against a statement's truth in 800 made houses
is right in 64 % of the draws expected in 200 others; with 0.7, in 54 %; with 1, betting on it is right in 51 %."""

SCENES_ADDED: Final = 30.0
"""Number of scenes whose draws are added to either truth of a statement. Statements of few scenes are changed less:
those with one truth would never be asked otherwise, and scenes with little to ask would be left with nothing. Eleven
scans of Gibson give 46 texts with 10 and 50 texts with 30; 1,000 made houses pass the bias gate with either."""

SHARED_WORD_WEIGHT: Final = 0.04
"""Weight of a room whose word fits another room of its scene too, relative to a room with a word of its own. Such a
room is preferred ten times less (``PLAIN_ROOM_WEIGHT``), and often no object tells it from the others. Chosen on
755,705 episodes of 4,000 made houses; 0.02 and 0.1 fit them nearly as well."""


class SceneRows:
    """The occurrences of statements in the rooms of a family's scenes, collected scene by scene from rows as
    ``LabelPriors.of_scene`` counts them. A row without a label begins a room. They are written to a temporary file,
    some hundred scenes at a time, so that only the statements themselves are in memory.
    """

    def __init__(self, family: str, directions: str) -> None:
        self._asked = {"", *(asked_in(family) & sayable(directions))}
        self._pending: list[pa.Table] = []
        self._rows = 0
        self._numbers: dict[Statement, int] = {}
        self._types: dict[str, int] = {}
        self._blocks = ArrayFile(4)

    def add(self, rows: pa.Table, most: int) -> None:
        """Add the rows of one scene. They are kept as they are until there are more than `most` of them."""
        self._pending.append(rows)
        self._rows += rows.num_rows
        if self._rows > most:
            self._read()

    def _read(self) -> None:
        """Read the rows that were only kept."""
        if not self._rows:
            self._pending = []
            return
        table = pa.concat_tables(self._pending).combine_chunks()
        scene = np.repeat(np.arange(len(self._pending)), [one.num_rows for one in self._pending])
        self._pending, self._rows = [], 0
        texts = [CodedTexts.of(table[name]) for name in STATEMENT[:-1]]
        room_type, label, predicate, _ = texts
        begins = label.among({""})
        room = np.cumsum(begins) - 1
        said = np.flatnonzero(~begins & predicate.among(self._asked))
        own, found = numbered_statements(texts, table["definite"].to_numpy(), said)
        known = self._numbers
        own = np.array([known.setdefault(statement, len(known)) for statement in found], np.int64)[own]
        there = [np.flatnonzero(table[name].to_numpy()[said] > 0) for name in ("n_false", "n_true")]
        at = np.concatenate(there)
        types = np.array([self._types.setdefault(name, len(self._types)) for name in room_type.texts], np.int64)
        code = 2 * own[at] + np.repeat([0, 1], [*map(len, there)])
        self._blocks.append(code, room[said[at]], scene[begins], types[room_type.numbers[begins]])

    @property
    def statements(self) -> list[Statement]:
        """The statements by number."""
        self._read()
        return list(self._numbers)

    @property
    def room_types(self) -> list[str]:
        """The types of rooms by number."""
        self._read()
        return list(self._types)

    def blocks(self) -> Iterator[tuple[I32, ...]]:
        """Yield the occurrences in some scenes: 2 × the number of the statement + its truth (n,), the room (n,), and
        the scene and the type of each room, both (r,). Rooms and scenes are numbered from 0 in each block.
        """
        self._read()
        yield from self._blocks


def family_log_factors(
    rows: SceneRows,
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
    places: PlacesConfig,
) -> dict[Statement, int]:
    """Return, by statement, by how many steps (``FACTOR_STEPS`` double it) its weight is raised where it is true
    and lowered where it is false; negative, the other way round. Statements that keep their weights are left out.

    Parameters
    ----------
    counts : number of rooms, of all families, in which each statement is true and false, and, for a label that is
        empty, of all rooms of the type
    label_factors : see ``PriorBits.label_weights``
    """
    statements = rows.statements
    if not statements:
        return {}
    draws = _FamilyDraws(rows, _family_weights(statements, counts, label_factors, sampling, places), sampling)
    steps = rounded_log_factors(fitted_log_factors(draws, FAMILY_IMBALANCE * hashed_signs(statements), SCENES_ADDED))
    return {statements[k]: int(steps[k]) for k in np.flatnonzero(steps).tolist()}


class _FamilyDraws:
    """The expected draws in all scenes, in blocks of scenes, which are read from a temporary file.

    weights (2, s) : of each statement, where it is false and where it is true
    """

    def __init__(self, rows: SceneRows, weights: F64, sampling: SamplingConfig) -> None:
        statements = rows.statements
        self._room_words = RoomWords(rows.room_types, vocabulary)
        self._weights = weights.T.ravel()
        self._said = np.array([*(getattr(sampling.predicates, name) for name in PREDICATE_GROUPS), 0.0])
        self._asked = np.zeros(len(self._said))
        self._asked[-1] = sampling.label_only(single_room=False)
        self._file = ArrayFile(7)
        groups = {name: k for k, name in enumerate(PREDICATE_GROUPS)}
        of_predicate: dict[str, int] = {name: groups[group] for name, group in GROUP_OF.items()}
        of_predicate[""] = len(groups)
        kind_of = np.array([of_predicate[p] for _, _, p, _, _ in statements], np.int64)
        forms = {form: k for k, form in enumerate(dict.fromkeys((p, definite) for _, _, p, _, definite in statements))}
        form_of = np.array([forms[p, definite] for _, _, p, _, definite in statements], np.int64)
        for code, room, scene_of_room, type_of_room in rows.blocks():
            alone = np.bincount(scene_of_room)[scene_of_room][room] == 1
            # Of a single room, absence is claimed by the labels of other scenes.
            kept = (self._weights[code] > 0) & ~((kind_of[code >> 1] == len(groups)) & alone)
            code, room = code[kept], room[kept]
            kind = kind_of[code >> 1]
            form, first = numbered(room, form_of[code >> 1])
            group, begins = numbered(room, kind)
            self._file.append(code, form, group[first], room[begins], scene_of_room, kind[begins], type_of_room)

    def __iter__(self) -> Iterator[ExpectedDraws]:
        for code, form, group_of_form, room_of_group, scene_of_room, kind, type_of_room in self._file:
            yield ExpectedDraws(
                code,
                self._weights[code],
                form=form,
                group_of_form=group_of_form,
                room_of_group=room_of_group,
                scene_of_room=scene_of_room,
                group_weights=self._said[kind],
                presence=self._asked[kind],
                room_weights=self._room_words.weights(scene_of_room, type_of_room),
            )


class RoomWords:
    """How often conditions are expected about each room of a scene, judged by whether the word for its type fits other
    rooms there too (see ``referents.room_refs``).

    types : of rooms, by number
    """

    def __init__(self, types: Sequence[str], words: Vocabulary) -> None:
        self._fit = np.array([words.room(one).fit_for_text for one in types], bool)
        self._meant = np.array([[words.might_mean_room(one, other) for other in types] for one in types], np.int64)

    def weights(self, scene_of_room: I32, type_of_room: I32) -> F64:
        """Return the weight of each room (r,) relative to the other rooms of its scene. It is 0 if the word for the
        type is not fit for text, unless the room is the only one. Scenes are numbered from 0.
        """
        there = np.zeros((int(scene_of_room.max(initial=-1)) + 1, len(self._fit)), np.int64)
        np.add.at(there, (scene_of_room, type_of_room), 1)
        alike = (there @ self._meant.T)[scene_of_room, type_of_room]
        found: F64 = np.where(self._fit[type_of_room], np.where(alike == 1, 1.0, SHARED_WORD_WEIGHT), 0.0)
        found[there.sum(axis=1)[scene_of_room] == 1] = 1.0  # the only room of a scene needs no name
        return found


def _family_weights(
    statements: list[Statement],
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
    places: PlacesConfig,
) -> F64:
    """Return the weights of the statements without factors, (2, s): where they are false and where they are true."""
    counted = np.array([counts.get(one, (0, 0)) for one in statements], np.float64)
    factors = np.array([label_factors.get((t, x, p, d), (1.0, 1.0)) for t, x, p, _, d in statements])
    weights = statement_weights(counted)
    found: F64 = np.stack([weights[False], weights[True]]) * factors.T
    present = np.array([not one[2] for one in statements], bool)
    rooms = np.array([counts.get((one[0], "", "", "", False), (0, 0))[0] for one in statements], np.float64)
    there = counted[:, 0]
    asked = np.array([present[k] and presence_asked(*one[:2], places) for k, one in enumerate(statements)], bool)
    plausible = (there >= sampling.plausible_share * rooms) & asked
    varies = plausible & (rooms - there >= sampling.plausible_share * rooms)
    found[0] *= np.where(present, plausible, 1.0)
    found[1] *= np.where(present, varies, 1.0)
    return found

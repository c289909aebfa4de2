"""Priors over rooms: which labels are usual, and how often a statement is true, pooled over all sources.

The priors are a separate unit, made in a first pass and pinned. For each label, a scene reads only yes/no bits; for
each statement, it reads how evenly the statement is true and false in rooms of the scene's types. A statement whose
truth is predictable from its words ("a pillow near the bed") is then rarely used, and as often where it is false as
where it is true. If the scene is one of many variants of a layout, only variants of this layout count: a statement that
is true throughout one layout and false throughout another looks balanced in the pool, but is predictable for a guesser
that knows the layout.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import islice, repeat
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from condvln.instructions.absence import presence_asked
from condvln.instructions.balance import (
    ByConditions,
    LabelForm,
    SceneRows,
    family_log_factors,
    label_weights,
    staging_factors,
)
from condvln.instructions.expected_draws import FACTOR_STEPS
from condvln.instructions.likeness import called_otherwise
from condvln.instructions.predicates import PREDICATE_GROUPS, sayable
from condvln.instructions.referents import Referents
from condvln.instructions.statement_counts import STATEMENT, StagedPresence, Statement, StatementCounts, table_of
from condvln.instructions.statements import statement_truths
from condvln.labels import vocabulary
from condvln.relations import relate_room, text_facts
from condvln.scene import Room, RoomArrays, Scene, SceneObject
from condvln.scene.scene import layout_of
from condvln.scene.tables import room_of
from schemas.canonical import JSON
from schemas.config import PlacesConfig, PredicateWeights, SamplingConfig, Thresholds
from schemas.config.constants import EVIDENCE, RATE_STEPS, STAGINGS
from schemas.program import asked_in

__all__ = ["PRIORS", "LabelPriors", "PriorBits", "Statement"]

PRIORS: Final = pa.schema(
    [
        *(pa.field(name, pa.string(), nullable=False) for name in ("layout", "staging", *STATEMENT[:-1])),
        pa.field("definite", pa.bool_(), nullable=False),
        *(pa.field(name, pa.int64(), nullable=False) for name in ("n_true", "n_false", "tilt")),
    ]
)
"""The number of rooms of a type in which a statement is usable as true and as false, by layout and, in a layout, by
scene id (both empty for scenes that are not variants of a layout). `tilt` is 0 but in rows without counts: in those,
`staging` is a family, and `tilt` is the binary logarithm of the statement's factor in its scenes, in steps (see
``fitted_weights``).

A row with an empty label counts the rooms of a type. A row with an empty predicate is the presence of a label, counted
as false in rooms where absence can be claimed: another room of the same scene has the label, and no word for it fits
anything in this room. In a staging that is a single room, labels that are not seen there but of which something there
might be called have a row without counts: see ``StagedPresence``.
"""

DEFAULT_WEIGHTS: Final = PredicateWeights()
DEFAULT_PLACES: Final = PlacesConfig()

LAYOUTS_KEPT: Final = 8
"""Number of layouts whose factors are kept for the next scene of the layout."""

MERGE_ROWS: Final = 200_000
"""Number of rows collected before they are summed: limits memory without summing for every scene."""

_KEYS: Final = ("layout", "staging", *STATEMENT)
_SUMMED: Final = ("n_true", "n_false", "tilt")


@dataclass(frozen=True, slots=True)
class PriorBits:
    """The part of the priors that one scene reads. It covers the scene's room types and labels; if the scene is a
    single room, it covers all labels.

    plausible : by room type, labels found in enough rooms of that type, of which an agent can see that there is none
    varies : the plausible labels that are also absent from enough rooms of the type, so that their presence is
        informative
    counts : by statement, the number of rooms in which it is true and of those in which it is false; if the scene's
        layout has enough rooms, only these are counted, and of a single room presence that is not asked counts as
        having one truth; statements never found are missing, and so may be relations of labels that the scene has in
        different types of rooms only
    staged : room types for which only rooms of the scene's layout are counted
    label_weights : by room type, label, predicate and definiteness, factors for the weights of false and true
        statements (``balance.label_weights``); of room types that are not `staged`
    even : by statement, the factor by which the weight of a true one is multiplied and that of a false one divided, in
        programs of one condition and of several; see ``fitted_weights``
    """

    plausible: Mapping[str, frozenset[str]]
    varies: Mapping[str, frozenset[str]]
    counts: Mapping[Statement, tuple[int, int]]
    staged: frozenset[str] = frozenset()
    label_weights: Mapping[LabelForm, tuple[float, float]] = field(default_factory=dict)
    even: Mapping[Statement, ByConditions] = field(default_factory=dict)

    def evidence(self, room_type: str) -> int:
        """Return the minimum number of rooms of type `room_type` in which a statement must be counted before its counts
        can show whether its truth varies.
        """
        return STAGINGS if room_type in self.staged else EVIDENCE

    def document(self) -> dict[str, JSON]:
        """Return these priors as sorted JSON. Instead of the rate at which each statement is true, the JSON holds one
        hash of all these rates. Equal priors give equal bytes.
        """
        return {
            "plausible": {room_type: sorted(labels) for room_type, labels in sorted(self.plausible.items())},
            "varies": {room_type: sorted(labels) for room_type, labels in sorted(self.varies.items())},
            "rates": self._rates(),
            **({"staged": sorted(self.staged)} if self.staged else {}),
        }

    def _rates(self) -> str:
        rates: list[tuple[object, ...]] = [
            (*key, round(RATE_STEPS * true / (true + false))) for key, (true, false) in sorted(self.counts.items())
        ]
        rates += [(*form, *(round(RATE_STEPS * x) for x in both)) for form, both in sorted(self.label_weights.items())]
        rates += [(*key, *both) for key, both in sorted(self.even.items())]
        return hashlib.sha256(orjson.dumps(rates)).hexdigest()


@dataclass(frozen=True, eq=False)
class LabelPriors:
    """Counts of labels and statements in rooms. Counts of several scenes are added by `merged`, in any order and
    grouping; `of_corpus` needs the order of ids, on which sums of floats depend.

    parts : tables of schema `PRIORS`, to be summed
    summed : the one part is sorted, and no two rows of it are about the same statement
    """

    parts: tuple[pa.Table, ...]
    summed: bool = False

    @classmethod
    def of_scene(
        cls, scene: Scene, thresholds: Thresholds, anchor_size: float, *, usual_places: bool = False
    ) -> LabelPriors:
        """Return the counts of one scene, computed from the boxes of its objects.

        thresholds, anchor_size, usual_places : those used for drawing conditions, so that exactly the possible
            statements are counted
        """
        boxes = [(room, scene.arrays(room.room_id)) for room in scene.rooms]
        return cls(_of_rooms(scene.scene_id, boxes, thresholds, anchor_size, usual_places))

    @classmethod
    def of_tables(
        cls,
        rooms: pa.Table,
        objects: pa.Table,
        thresholds: Thresholds,
        anchor_size: float,
        *,
        usual_places: bool = False,
    ) -> LabelPriors:
        """Return the counts of any number of scenes of one family, from their ``rooms`` and ``objects`` tables; see
        `of_scene`.
        """
        scenes = _boxes(rooms, objects)
        read = thresholds, anchor_size, usual_places
        return cls(tuple(part for name, boxes in scenes for part in _of_rooms(name, boxes, *read)))

    @classmethod
    def merged(cls, parts: Iterable[LabelPriors]) -> LabelPriors:
        """Return the sum of `parts`. Their order does not matter."""
        pending: list[pa.Table] = []
        rows = 0
        for part in parts:
            pending.extend(part.parts)
            rows += sum(table.num_rows for table in part.parts)
            if rows > MERGE_ROWS:
                pending, rows = [_summed(pending)], 0
        return cls((_summed(pending),), summed=True)

    @classmethod
    def of_corpus(
        cls,
        scenes: Iterable[tuple[str, LabelPriors]],
        sampling: SamplingConfig,
        directions: str = "compass",
        places: PlacesConfig = DEFAULT_PLACES,
    ) -> LabelPriors:
        """Return the sum of the counts of all scenes of a run, and how much weights of statements are changed so that
        each is drawn about as often true as false over all scenes of a family.

        scenes : family and counts of each scene, in the order of their ids, so that sums are the same to the last bit
        """
        read: dict[str, SceneRows] = {}

        def noted() -> Iterator[LabelPriors]:
            for family, counts in scenes:
                rows = counts.rows()
                if rows.num_rows and not rows["layout"][0].as_py():
                    read.setdefault(family, SceneRows(family, directions)).add(rows, MERGE_ROWS)
                yield counts

        summed = cls.merged(noted())
        counted = summed._statements.all()
        factors = {form: both for forms in summed._weights.values() for form, both in forms.items()}
        found = [
            _factor_rows(name, family_log_factors(rows, counted, factors, sampling, places))
            for name, rows in sorted(read.items())
        ]
        return cls.merged([summed, cls(tuple(found))])

    @cached_property
    def _counts(self) -> pa.Table:
        return self.parts[0] if self.summed else _summed(self.parts)

    def rows(self) -> pa.Table:
        """Return the counts as they are, not summed: a table of schema `PRIORS`."""
        return pa.concat_tables([PRIORS.empty_table(), *self.parts]).combine_chunks()

    def table(self) -> pa.Table:
        """Return the sums as a table of schema `PRIORS`, sorted."""
        return self._counts

    @classmethod
    def from_table(cls, table: pa.Table) -> LabelPriors:
        """Return the counts from a table of schema `PRIORS`."""
        return cls((table,))

    def bits(
        self,
        scene: Scene,
        plausible_share: float,
        predicates: PredicateWeights = DEFAULT_WEIGHTS,
        directions: str = "compass",
        presence_share: float | None = None,
        places: PlacesConfig = DEFAULT_PLACES,
    ) -> PriorBits:
        """Return the part of the priors that `scene` reads.

        Parameters
        ----------
        plausible_share : a label is plausible in a room type if at least this share of the rooms of the type have an
            object with the label
        predicates, directions, presence_share : the weights of the predicates with which conditions are drawn, the
            directions that texts may use, and the share of conditions of presence in this scene (by default that of
            the configuration's defaults); all matter only for stagings of a layout
        places : what an agent sees, and so of which labels it can see that there is none
        """
        if presence_share is None:
            presence_share = SamplingConfig().label_only(scene.single_room)
        types = sorted({room.label for room in scene.rooms})
        seen = sorted({o.label for o in scene.objects})
        everywhere = self._statements
        rows = everywhere.rows(types, seen, all_present=scene.single_room)
        found = everywhere.presence(rows)
        layout = layout_of(scene.scene_id)
        stagings_of = _of_layout(self, layout) if layout else None
        own_rows = stagings_of.rows(types, seen, all_present=scene.single_room) if stagings_of else rows[:0]
        own = stagings_of.counts(own_rows) if stagings_of else {}
        rooms = {t: found.pop((t, "", "", "", False), (0, 0))[0] for t in types}
        presence = {(t, x): n for (t, x, *_), (n, _) in found.items()}
        plausible = {
            (t, x) for (t, x), n in presence.items() if n >= plausible_share * rooms[t] and presence_asked(t, x, places)
        }
        varies = {key for key in plausible if rooms[key[0]] - presence[key] >= plausible_share * rooms[key[0]]}
        stagings = {t: own.pop((t, "", "", "", False), (0, 0))[0] for t in types}
        staged = frozenset(t for t in types if stagings[t] >= STAGINGS)
        read = rows if scene.single_room else everywhere.sayable(rows, _labels_of_types(scene))
        counts = everywhere.counts(everywhere.of_labels(read, {*types} - staged))
        if staged:
            counts.update({key: both for key, both in own.items() if key[0] in staged})
        if scene.single_room:
            # In a single-room scene, absence can be claimed of labels of other scenes. Of a staging, only labels are
            # asked that some stagings have, and whose absence can be claimed of others. The rest is counted as having
            # one truth, so that it is never asked.
            known = _presence(self, layout, tuple(sorted(staged)), frozenset(varies)).counts if staged else {}
            for t, x in presence:
                there = counts.get((t, x, "", "", False), (0, 0))[0]
                if not staged:
                    both = (there, rooms[t] - there)
                else:
                    both = known.get((t, x)) or ((stagings[t], 0) if there else (0, stagings[t]))
                counts[t, x, "", "", False] = both
        weights = self._label_weights(seen, set(types) - staged)
        of_family = self._family_factors.get(scene.family, {})
        # Of a single room that is no staging, presence is not fitted: what is absent is absent from the whole scene.
        fitted = [key for key in counts if key[2] or not scene.single_room]
        even = {key: of_family[key] for key in fitted if key in of_family and key[0] not in staged}
        if staged:
            even |= self._even(scene, counts, staged, varies, predicates, directions, presence_share, places)
        return PriorBits(
            plausible={t: frozenset(x for of, x in plausible if of == t) for t in types},
            varies={t: frozenset(x for of, x in varies if of == t) for t in types},
            counts=counts,
            staged=staged,
            label_weights=weights,
            even=even,
        )

    def _label_weights(self, labels: Sequence[str], types: Collection[str]) -> dict[LabelForm, tuple[float, float]]:
        """Return the weights of a scene's labels; see `PriorBits`. They come from counts of statements with any anchor,
        even anchors that the scene lacks.
        """
        found = (self._weights.get((t, x), {}) for t in sorted(types) for x in labels)
        return {form: both for forms in found for form, both in forms.items()}

    @cached_property
    def _family_factors(self) -> dict[str, dict[Statement, ByConditions]]:
        """The factors of statements by family."""
        found: dict[str, dict[Statement, ByConditions]] = {}
        rows = self._counts.filter(pc.not_equal(self._counts["tilt"], 0))
        columns = [rows[name].to_pylist() for name in ("staging", *STATEMENT)]
        factors = np.exp2(rows["tilt"].to_numpy() / FACTOR_STEPS).tolist()
        for (family, *statement), factor in zip(zip(*columns, strict=True), factors, strict=True):
            found.setdefault(family, {})[tuple(statement)] = ByConditions(factor, factor)
        return found

    @cached_property
    def _statements(self) -> StatementCounts:
        return StatementCounts(self._counts)

    @cached_property
    def _weights(self) -> dict[tuple[str, str], dict[LabelForm, tuple[float, float]]]:
        """The weights of all labels, by room type and label."""
        found: dict[tuple[str, str], dict[LabelForm, tuple[float, float]]] = {}
        for form, both in label_weights(self._counts.filter(pc.not_equal(self._counts["predicate"], ""))).items():
            found.setdefault(form[:2], {})[form] = both
        return found

    def _even(
        self,
        scene: Scene,
        statements: Container[Statement],
        staged: frozenset[str],
        varies: Collection[tuple[str, str]],
        predicates: PredicateWeights,
        directions: str,
        presence_share: float,
        places: PlacesConfig,
    ) -> dict[Statement, ByConditions]:
        """Return the factors of `statements`; see `PriorBits`. They come from all statements about all stagings of the
        scene's layout.

        varies : type of room and label, of labels whose presence may be asked
        """
        asked = ("", *sorted(asked_in(scene.family) & sayable(directions)))
        weights = tuple((group, getattr(predicates, group)) for group in PREDICATE_GROUPS)
        alone = frozenset(varies) if scene.single_room else None
        layout, types = layout_of(scene.scene_id), tuple(sorted(staged))
        found = _factors(self, layout, types, asked, weights, presence_share, alone, places)
        return {key: factors for key, factors in found.items() if key in statements}

    def about(self, layout: str, room_types: Sequence[str], predicates: Sequence[str]) -> pa.Table:
        """Return the rows about labels in rooms of a layout that are of one of the types and have one of the
        predicates, the empty one for presence.
        """
        read = pc.and_(
            pc.equal(self._counts["layout"], layout),
            pc.is_in(self._counts["room_type"], pa.array(room_types, pa.string())),
        )
        read = pc.and_(read, pc.not_equal(self._counts["label"], ""))
        asked = pc.is_in(self._counts["predicate"], pa.array(predicates, pa.string()))
        return self._counts.filter(pc.and_(read, asked))


def _labels_of_types(scene: Scene) -> dict[str, set[str]]:
    """Return the labels of the objects in a scene's rooms, by type of room."""
    found: dict[str, set[str]] = {}
    for item in scene.objects:
        if item.room_id in scene.room_of:
            found.setdefault(scene.room_of[item.room_id].label, set()).add(item.label)
    return found


@lru_cache(maxsize=LAYOUTS_KEPT)
def _factors(
    priors: LabelPriors,
    layout: str,
    staged: tuple[str, ...],
    asked: tuple[str, ...],
    weights: tuple[tuple[str, float], ...],
    presence_share: float,
    varies: frozenset[tuple[str, str]] | None,
    places: PlacesConfig,
) -> Mapping[Statement, ByConditions]:
    """Return the factors of all statements about the stagings of a layout: equal for all its scenes of a single room,
    and for all others, since what one scene holds does not enter.

    varies : if the layout is a single room, the labels whose presence may be asked
    """
    rows = priors.about(layout, staged, asked)
    relations = rows.filter(pc.not_equal(rows["predicate"], ""))
    if varies is not None:
        presence = _presence(priors, layout, staged, varies).rows
    else:
        presence = rows.filter(pc.equal(rows["predicate"], ""))
        said = zip(presence["room_type"].to_pylist(), presence["label"].to_pylist(), strict=True)
        presence = presence.filter(pa.array([presence_asked(*one, places) for one in said], pa.bool_()))
    rows = pa.concat_tables([relations, presence]).combine_chunks()
    return staging_factors(rows, dict(weights), presence_share)


@lru_cache(maxsize=LAYOUTS_KEPT)
def _presence(
    priors: LabelPriors, layout: str, staged: tuple[str, ...], varies: frozenset[tuple[str, str]]
) -> StagedPresence:
    """Return the presence of labels in the stagings of a layout that is a single room."""
    rows = priors.table()
    held = pc.and_(pc.equal(rows["layout"], layout), pc.is_in(rows["room_type"], pa.array(staged, pa.string())))
    return StagedPresence.of(rows.filter(pc.and_(held, pc.equal(rows["predicate"], ""))), varies)


@lru_cache(maxsize=LAYOUTS_KEPT)
def _of_layout(priors: LabelPriors, layout: str) -> StatementCounts:
    """Return the counts of statements about the stagings of one layout."""
    rows = priors.table()
    return StatementCounts(rows.filter(pc.equal(rows["layout"], layout)))


def _summed(parts: Sequence[pa.Table]) -> pa.Table:
    joined = pa.concat_tables([PRIORS.empty_table(), *parts]).group_by(list(_KEYS))
    sums = joined.aggregate([(name, "sum") for name in _SUMMED]).rename_columns([*_KEYS, *_SUMMED])
    return sums.sort_by([(key, "ascending") for key in _KEYS]).cast(PRIORS)


def _factor_rows(family: str, found: Mapping[Statement, int]) -> pa.Table:
    """Return the binary logarithms of the factors of a family's statements as rows."""
    return table_of([("", family, *statement, 0, 0, steps) for statement, steps in found.items()], PRIORS)


def _of_rooms(
    scene_id: str,
    boxes: Sequence[tuple[Room, RoomArrays]],
    thresholds: Thresholds,
    anchor_size: float,
    usual_places: bool,
) -> tuple[pa.Table, ...]:
    """Return the counts of each room of one scene."""
    labels = [_seen(arrays) for _, arrays in boxes]
    alone, read = len(boxes) == 1, (thresholds, anchor_size, usual_places)
    return tuple(
        _of_room(scene_id, room, arrays, set().union(*labels[:k], *labels[k + 1 :]), *read, alone)
        for k, (room, arrays) in enumerate(boxes)
    )


def _of_room(
    scene_id: str,
    room: Room,
    arrays: RoomArrays,
    elsewhere: set[str],
    thresholds: Thresholds,
    anchor_size: float,
    usual_places: bool,
    alone: bool,
) -> pa.Table:
    here, possible, layout = _seen(arrays), set(arrays.labels), layout_of(scene_id)
    possible = possible.union(*called_otherwise(arrays))
    absent = {label for label in elsewhere if not possible & vocabulary.overlapping(label)}
    rows = _Rows()
    rows.add(["", *sorted(here)], "", repeat(""), repeat(False), repeat(1), repeat(0))
    rows.add(sorted(absent), "", repeat(""), repeat(False), repeat(0), repeat(1))
    if layout and alone:
        rows.add(sorted(possible - here), "", repeat(""), repeat(False), repeat(0), repeat(0))
    if room.complete and len(arrays):
        facts = text_facts(relate_room(arrays, thresholds), thresholds)
        referents = Referents.of(room, arrays, facts, vocabulary, anchor_size)
        for truths in statement_truths(referents, vocabulary, usual_places=usual_places):
            subjects, anchors = np.nonzero(truths.true | truths.false)
            keys = truths.anchor_keys(arrays.labels)
            rows.add(
                [truths.labels[k] for k in subjects.tolist()],
                truths.predicate,
                [keys[k] for k in anchors.tolist()],
                truths.definite[subjects].tolist(),
                truths.true[subjects, anchors].astype(np.int64).tolist(),
                truths.false[subjects, anchors].astype(np.int64).tolist(),
            )
    return rows.table(layout, scene_id if layout else "", room.label)


def _seen(arrays: RoomArrays) -> set[str]:
    """Return the labels of the objects that are not hidden."""
    return {label for label, hidden in zip(arrays.labels, arrays.hidden, strict=True) if not hidden}


class _Rows:
    """Rows of counts in one room of one scene, collected as columns."""

    def __init__(self) -> None:
        self._columns: tuple[list[Any], ...] = ([], [], [], [], [], [])

    def add(
        self,
        labels: list[str],
        predicate: str,
        anchors: Iterable[str],
        definite: Iterable[bool],
        true: Iterable[int],
        false: Iterable[int],
    ) -> None:
        """Add a row for each label; of the other values, only as many are taken."""
        for column, values in zip(
            self._columns, (labels, repeat(predicate), anchors, definite, true, false), strict=True
        ):
            column.extend(islice(values, len(labels)))

    def table(self, *same: str) -> pa.Table:
        """Return the rows; `same` are their layout, staging and type of room."""
        n = len(self._columns[0])
        kinds = [kind.type for kind in PRIORS]
        columns = [pa.repeat(pa.scalar(value, pa.string()), n) for value in same]
        columns += [pa.array(values, kind) for values, kind in zip(self._columns, kinds[3:-1], strict=True)]
        columns.append(pa.repeat(pa.scalar(0, pa.int64()), n))
        return pa.table(columns, schema=PRIORS)


def _boxes(rooms: pa.Table, objects: pa.Table) -> Iterator[tuple[str, list[tuple[Room, RoomArrays]]]]:
    """Yield (scene id, the scene's rooms with their objects as boxes) for each scene of the tables `rooms` and
    `objects`.
    """
    held: dict[tuple[str, str], list[SceneObject]] = {}
    names = ("scene_id", "room_id", "object_id", "raw_label", "label", "radius", "hidden")
    wanted = [*names, "center", "aabb_min", "aabb_max"]
    for row in objects.select(wanted).to_pylist():
        low, high = row["aabb_min"], row["aabb_max"]
        item = SceneObject(
            **{name: row[name] for name in names[1:]},
            center=_point(row["center"]),
            aabb=None if low is None or high is None else np.array([_point(low), _point(high)]),
        )
        held.setdefault((row["scene_id"], row["room_id"]), []).append(item)
    scenes: dict[str, list[tuple[Room, RoomArrays]]] = {}
    for row in rooms.to_pylist():
        room = room_of(row)
        arrays = RoomArrays.of(room.room_id, held.get((row["scene_id"], row["room_id"]), []), room.floor_y)
        scenes.setdefault(row["scene_id"], []).append((room, arrays))
    yield from scenes.items()


def _point(value: Mapping[str, float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([value["x"], value["y"], value["z"]])

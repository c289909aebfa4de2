"""The pool: the light columns of all episodes of a snapshot, from which splits are selected. The other columns are read
only when the splits are written.

A million episodes must fit in a fraction of a gigabyte, so names are kept as 64-bit hashes. The probability that two of
a million collide is 3e-8; the effect is only that two programs are kept in one split unnecessarily.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.identity import colliding
from condvln.export.tokens import tokenize
from schemas.config.constants import STEP_CEILING
from schemas.errors import StoreError
from schemas.program import CATEGORIES

__all__ = [
    "FIT",
    "INSTRUCTION_COLUMNS",
    "POOL_COLUMNS",
    "Codes",
    "ExportPool",
    "Hashes",
    "PoolBuilder",
    "hashes_of",
]

POOL_COLUMNS: Final = (
    "scene_id",
    "episode_id",
    "episode_hash",
    "instruction_id",
    "group_id",
    "category",
    "composition",
    "observability",
    "gold_leaf",
    "n_leaves",
    "start_position",
    "ground_truth_steps",
    "max_steps",
    "instruction_text",
)
INSTRUCTION_COLUMNS: Final = ("instruction_id", "conditions", "branches", "leaves")

FIT: Final = 0
"""Code of an episode that may be in a split."""

_OVER_BUDGET: Final = "over the step budget"
_OVER_TOKENS: Final = "more tokens than an agent reads"
_COLLISION: Final = "id_collision: its integer id is that of an episode of smaller hash"
_REPEAT: Final = "same text from the same start as another"

Codes = npt.NDArray[np.int64]
Hashes = npt.NDArray[np.uint64]


@dataclass(frozen=True)
class ExportPool:
    """The pool's columns, one entry per episode, in the order in which the snapshot is read.

    ``source``, ``scene``, ``category``, ``stratum`` and ``unfit`` are indices into names; ``episode``, ``instruction``,
    ``unit`` and ``start`` (a position in a scene) are hashes.
    ``conditions[offsets[i]:offsets[i + 1]]`` are the kinds of condition (label, room type, and whether it is of
    presence, of a relation, or of one to whose anchor one is sent if it holds) in the instruction of episode ``i``,
    ``statements`` what each says in full (None if that was not asked for), ``truths`` whether it is true.
    ``reasons[unfit[i]]`` says why an episode can be in no split.
    """

    sources: tuple[str, ...]
    scenes: tuple[tuple[str, str], ...]
    strata: tuple[str, ...]
    kinds: tuple[str, ...]
    reasons: tuple[str, ...]
    episode: Hashes
    instruction: Hashes
    unit: Hashes
    start: Hashes
    grouped: npt.NDArray[np.bool_]
    source: Codes
    scene: Codes
    category: Codes
    leaf: Codes
    n_leaves: Codes
    stratum: Codes
    unfit: Codes
    offsets: Codes
    conditions: Codes
    statements: Codes | None
    truths: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.episode)


@dataclass
class _Names:
    """Assigns codes to names in the order in which they are first seen."""

    codes: dict[Any, int] = field(default_factory=dict)

    def __call__(self, name: Any) -> int:
        return self.codes.setdefault(name, len(self.codes))

    def all(self, names: pa.Array) -> npt.NDArray[np.int32]:
        """Return the code of each name in a column."""
        encoded = names.dictionary_encode()
        own = np.array([self(name) for name in encoded.dictionary.to_pylist()], dtype=np.int32)
        return own[encoded.indices.to_numpy()] if len(own) else own

    def listed(self) -> tuple[Any, ...]:
        return tuple(self.codes)


class PoolBuilder:
    """Builds a pool from batches of the instructions and episodes tables, added source by source.

    max_tokens : texts with more tokens are excluded; None or 0 means no limit
    statements : whether the pool has the conditions' statements
    """

    def __init__(self, max_tokens: int | None = None, statements: bool = False) -> None:
        self._max_tokens = max_tokens
        self._with_statements = statements
        self._sources, self._scenes, self._strata, self._kinds = _Names(), _Names(), _Names(), _Names()
        self._statements = _Names()
        self._reasons = _Names({"": FIT})
        self._columns: dict[str, list[npt.NDArray[Any]]] = {}
        self._ids: list[tuple[pa.Array, pa.Array]] = []
        self._asked: list[_Asked] = []

    def add_instructions(self, source: str, batches: Iterable[pa.RecordBatch]) -> None:
        """Add the conditions of the instructions of ``source`` (columns :data:`INSTRUCTION_COLUMNS`)."""
        for batch in batches:
            listed = batch.column("conditions")
            asked = listed.flatten()
            there = pc.if_else(_sent_there(batch), "sent", "relation")
            relation = pc.if_else(pc.is_valid(asked.field("qualifier")), there, "presence")
            room = asked.field("room").field("label")
            kinds = self._kinds.all(pc.binary_join_element_wise(asked.field("label"), room, relation, "\t"))
            truths = asked.field("truth").to_numpy(zero_copy_only=False).astype(bool)
            names = hashes_of((source, name) for name in batch.column("instruction_id").to_pylist())
            counts = pc.list_value_length(listed).to_numpy().astype(np.int64)
            said = np.zeros(len(kinds), dtype=np.int32)
            if self._with_statements:
                said = self._statements.all(_statements(source, asked, room))
            self._asked.append(_Asked(names, counts, kinds, said, truths))

    def add_episodes(self, source: str, batch: pa.RecordBatch, barred: Mapping[str, str] | None = None) -> None:
        """Add episodes of ``source`` (columns :data:`POOL_COLUMNS`). ``barred`` has the excluded scenes by id, each
        with the reason.
        """
        column = {name: batch.column(name).to_pylist() for name in POOL_COLUMNS if name not in _NUMBERS}
        number = {name: batch.column(name).to_numpy().astype(np.int64) for name in _NUMBERS}
        scenes, units = column["scene_id"], _units(column)
        starts = ["\0".join(map(str, start.values())) for start in column["start_position"]]
        reasons = [(barred or {}).get(scene, "") for scene in scenes]
        steps = number["ground_truth_steps"]
        over = (2 * steps > STEP_CEILING) | (steps > number["max_steps"])
        unfit = np.array([self._reasons(reason) for reason in reasons], dtype=np.int8)
        unfit[(unfit == FIT) & over] = self._reasons(_OVER_BUDGET)
        if self._max_tokens:
            longer = [len(tokenize(text)) > self._max_tokens for text in column["instruction_text"]]
            unfit[(unfit == FIT) & np.array(longer, dtype=bool)] = self._reasons(_OVER_TOKENS)
        strata = [f"{c} {o or ''}".strip() for c, o in zip(column["composition"], column["observability"], strict=True)]
        texts = zip(scenes, starts, column["instruction_text"], strict=True)
        self._append(
            source=np.full(batch.num_rows, self._sources(source), dtype=np.int16),
            scene=np.array([self._scenes((source, scene)) for scene in scenes], dtype=np.int32),
            episode=hashes_of((name,) for name in column["episode_hash"]),
            instruction=hashes_of((source, name) for name in column["instruction_id"]),
            unit=hashes_of((source, scene, unit) for scene, unit in zip(scenes, units, strict=True)),
            start=hashes_of((source, scene, start) for scene, start in zip(scenes, starts, strict=True)),
            grouped=np.array([group is not None for group in column["group_id"]], dtype=bool),
            category=np.array([CATEGORIES.index(name) for name in column["category"]], dtype=np.int8),
            leaf=number["gold_leaf"].astype(np.int8),
            n_leaves=number["n_leaves"].astype(np.int8),
            stratum=np.array([self._strata(name) for name in strata], dtype=np.int8),
            text=hashes_of((source, *parts) for parts in texts),
            unfit=unfit,
        )
        self._ids.append((batch.column("episode_id"), batch.column("episode_hash")))

    def _append(self, **columns: npt.NDArray[Any]) -> None:
        for name, values in columns.items():
            self._columns.setdefault(name, []).append(values)

    def build(self) -> ExportPool:
        """Return the pool of everything that was added.

        Raises
        ------
        StoreError : nothing was added, or two episodes have the same hash
        """
        if not sum(len(numbers) for numbers, _ in self._ids):
            raise StoreError(
                "the snapshot holds no episodes",
                remedy="Its rejections table has the reasons; correct the sources or the configuration, then generate",
            )
        columns = {name: np.concatenate(parts) for name, parts in self._columns.items()}
        self._refuse_repeats(columns["episode"])
        columns["unfit"][self._colliding()] = self._reasons(_COLLISION)
        fit = np.flatnonzero(columns["unfit"] == FIT)
        again = np.ones(len(fit), dtype=bool)
        again[np.unique(columns.pop("text")[fit], return_index=True)[1]] = False
        columns["unfit"][fit[again]] = self._reasons(_REPEAT)
        offsets, conditions, statements, truths = self._conditions(columns["instruction"])
        wide: dict[str, Any] = {
            name: values.astype(np.int64) if values.dtype.kind == "i" else values for name, values in columns.items()
        }
        return ExportPool(
            sources=self._sources.listed(),
            scenes=self._scenes.listed(),
            strata=self._strata.listed(),
            kinds=self._kinds.listed(),
            reasons=self._reasons.listed(),
            offsets=offsets,
            conditions=conditions,
            statements=statements if self._with_statements else None,
            truths=truths,
            **wide,
        )

    def _refuse_repeats(self, names: Hashes) -> None:
        unique, first = np.unique(names, return_index=True)
        if len(unique) == len(names):
            return
        again = np.setdiff1d(np.arange(len(names)), first)
        example = pa.chunked_array([found for _, found in self._ids])[int(again[0])]
        raise StoreError(
            f"{len(again)} episodes occur twice in the snapshot, such as the one with hash {example}",
            remedy="List each scene under one source only, then generate again",
        )

    def _colliding(self) -> list[int]:
        """Return the rows whose id also belongs to an episode with a smaller hash, in any scene."""
        numbers = np.concatenate([ids.to_numpy() for ids, _ in self._ids])
        if len(np.unique(numbers)) == len(numbers):
            return []
        return colliding(numbers.tolist(), [name for _, hashes in self._ids for name in hashes.to_pylist()])

    def _conditions(self, instructions: Hashes) -> tuple[Codes, Codes, Codes, npt.NDArray[np.bool_]]:
        """Return the conditions of each episode's instruction as ``offsets``, ``conditions``, ``statements`` and
        ``truths`` of `ExportPool`; an unknown instruction has no conditions.
        """
        names = _joined([part.names for part in self._asked], np.uint64)
        if not len(names):
            nothing = np.zeros(0, dtype=np.int64)
            return np.zeros(len(instructions) + 1, dtype=np.int64), nothing, nothing, nothing.astype(bool)
        counts = _joined([part.counts for part in self._asked], np.int64)
        kinds = _joined([part.kinds for part in self._asked], np.int32)
        said = _joined([part.statements for part in self._asked], np.int32)
        truths = _joined([part.truths for part in self._asked], bool)
        begins = np.concatenate(([0], np.cumsum(counts)))
        order = np.argsort(names, kind="stable")
        at = order[np.searchsorted(names, instructions, sorter=order).clip(max=len(names) - 1)]
        mine = np.where(names[at] == instructions, counts[at], 0)
        offsets = np.concatenate(([0], np.cumsum(mine))).astype(np.int64)
        places = np.arange(offsets[-1]) - np.repeat(offsets[:-1] - begins[at], mine)
        return offsets, kinds[places].astype(np.int64), said[places].astype(np.int64), truths[places]


class _Asked(NamedTuple):
    """Instructions of a batch: the hash of each name and its number of conditions; kind, statement and truth of each
    condition.
    """

    names: Hashes
    counts: Codes
    kinds: npt.NDArray[np.int32]
    statements: npt.NDArray[np.int32]
    truths: npt.NDArray[np.bool_]


def _sent_there(batch: pa.RecordBatch) -> pa.Array:
    """Return for each condition of the instructions whether one is sent to an anchor of its relation if it holds."""
    found: list[bool] = []
    columns = (batch.column(name).to_pylist() for name in ("conditions", "branches", "leaves"))
    for conditions, branches, leaves in zip(*columns, strict=True):
        goals = {b["condition"]: leaves[-1 - b["then"]]["moves"][-1]["object_id"] for b in branches if b["then"] < 0}
        for k, condition in enumerate(conditions):
            anchors = condition["qualifier"]["anchors"] if condition["qualifier"] else ()
            found.append(goals.get(k) in [anchor["object_id"] for anchor in anchors])
    return pa.array(found, pa.bool_())


def _statements(source: str, asked: pa.StructArray, room: pa.Array) -> pa.Array:
    """Return what each condition says in full: source, label, room type, predicate, labels of the anchors, and whether
    it names its object with a definite article.
    """
    anchors = asked.field("qualifier").field("anchors")
    labels = pa.ListArray.from_arrays(anchors.offsets, anchors.values.field("label"))
    words = (
        asked.field("label"),
        room,
        asked.field("qualifier").field("predicate"),
        pc.binary_join(labels, "\t"),
        pc.if_else(asked.field("definite"), "the", "a"),
    )
    return pc.binary_join_element_wise(source, *words, "\n", null_handling="replace", null_replacement="")


_NUMBERS: Final = ("gold_leaf", "n_leaves", "ground_truth_steps", "max_steps")


def _units(column: Mapping[str, list[Any]]) -> list[str]:
    """Return, for each episode, the name of its unit: its counterfactual group, or its instruction if it is in no
    group. A split has all episodes of a unit or none.
    """
    pairs = zip(column["group_id"], column["instruction_id"], strict=True)
    return [f"group {group}" if group is not None else f"instruction {instruction}" for group, instruction in pairs]


def hashes_of(names: Iterable[tuple[Any, ...]]) -> Hashes:
    """Return the 64-bit hash of each tuple of names."""
    digests = [hashlib.blake2b("\0".join(map(str, parts)).encode(), digest_size=8).digest() for parts in names]
    return np.frombuffer(b"".join(digests), dtype=">u8").astype(np.uint64)


def _joined(parts: Sequence[npt.NDArray[Any]], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=dtype)

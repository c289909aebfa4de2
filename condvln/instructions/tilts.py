"""By how much the weights of statements are changed so that over all scenes of a family each is drawn about as often
where it is true as where it is false.

A statement that is true in 97 of 100 rooms has a small weight where it is true. But each scene asks as much as any
other, so that in a room where all else has little weight too, it is asked all the same. Here the draws of all rooms are
computed, and one factor for each statement is fitted (``condvln.instructions.expected_draws``). The excess that is
aimed at is about that of a fair coin, and of the truth that a coin says, so that the excesses of a label's statements
do not add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.instructions.array_file import I32, ArrayFile
from condvln.instructions.expected_draws import (
    ExpectedDraws,
    coins,
    fitted_octaves,
    rounded_octaves,
)
from condvln.instructions.informative import LabelForm, statement_weights
from condvln.instructions.predicates import GROUP_OF, PREDICATE_GROUPS, sayable
from condvln.instructions.statement_rows import (
    STATEMENT,
    CodedTexts,
    Statement,
    numbered,
    numbered_statements,
)
from condvln.labels import Vocabulary, vocabulary
from schemas.config import SamplingConfig
from schemas.program import asked_in

__all__ = ["RoomWords", "SceneRows", "tilts"]

COIN_PART: Final = 0.9
"""Part of a fair coin's excess that is aimed at. With 0, betting against a statement's truth in 800 made houses is
right in 64 % of the draws expected in 200 others; with 0.7, in 54 %; with 1, betting on it is right in 51 %."""

SCENES_ADDED: Final = 30.0
"""Number of scenes whose draws are added to either truth of a statement. Statements of few scenes are changed less:
those with one truth would never be asked otherwise, and scenes with little to ask would be left with nothing. Eleven
scans of Gibson give 46 texts with 10 and 50 texts with 30; 1,000 made houses pass the bias gate with either."""

SHARED_WORD_WEIGHT: Final = 0.04
"""Weight of a room whose word fits another room of its scene too, relative to a room with a word of its own. Such a
room is preferred ten times less (``PLAIN_ROOM_WEIGHT``), and often no object tells it from the others. Chosen on
755,705 episodes of 4,000 made houses; 0.02 and 0.1 fit them nearly as well."""

F64 = NDArray[np.float64]


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


def tilts(
    rows: SceneRows,
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
) -> dict[Statement, int]:
    """Return, by statement, by how many steps (``FACTOR_STEPS`` make an octave) its weight is raised where it is true
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
    draws = _Draws(rows, _weights(statements, counts, label_factors, sampling), sampling)
    steps = rounded_octaves(fitted_octaves(draws, COIN_PART * coins(statements), SCENES_ADDED))
    return {statements[k]: int(steps[k]) for k in np.flatnonzero(steps).tolist()}


class _Draws:
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


def _weights(
    statements: list[Statement],
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
) -> F64:
    """Return the weights of the statements without tilts, (2, s): where they are false and where they are true."""
    counted = np.array([counts.get(one, (0, 0)) for one in statements], np.float64)
    factors = np.array([label_factors.get((t, x, p, d), (1.0, 1.0)) for t, x, p, _, d in statements])
    weights = statement_weights(counted)
    found: F64 = np.stack([weights[False], weights[True]]) * factors.T
    present = np.array([not one[2] for one in statements], bool)
    rooms = np.array([counts.get((one[0], "", "", "", False), (0, 0))[0] for one in statements], np.float64)
    there = counted[:, 0]
    plausible = there >= sampling.plausible_share * rooms
    varies = plausible & (rooms - there >= sampling.plausible_share * rooms)
    found[0] *= np.where(present, plausible, 1.0)
    found[1] *= np.where(present, varies, 1.0)
    return found

"""The possible stops of a program: objects that can be named and reached, and which of them are far enough apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import GROUP_OF
from condvln.instructions.referents import Referents
from condvln.labels import Vocabulary
from condvln.scene import Scene
from condvln.seeding import Draws
from schemas.config import PlacesConfig, SamplingConfig

__all__ = ["Stops", "Target", "TargetPool", "apart_by_centres", "targets"]


@dataclass(frozen=True, eq=False)
class Stops:
    """The reachable objects of a scene, and which of them are far enough apart.

    object_ids (n,) : objects with goal points; other objects are never stops
    apart (n, n) : two stops are far enough apart to be leaves of one program, or two moves of one leaf
    """

    object_ids: tuple[str, ...]
    apart: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Target:
    """An object that may be a stop.

    position : the object's index among all targets; index : its index among the objects of its room
    apart : the targets that may be stops of the same leaf, or goals of the same program: far enough away, and not in
        `alike`; as bits of an integer
    alike : the targets in other rooms that the same word might name, as bits
    clear : the object has a name other than those used only if nothing else can be named ("the chair away from the
        desk")
    """

    object_id: str
    position: int
    room_id: str
    index: int
    label: str
    weight: float
    apart: int
    alike: int
    clear: bool


class TargetPool:
    """Draws targets: first a label by its weight, then one of its objects uniformly.

    Parameters
    ----------
    members : per label its targets as bits
    weights : per label; labels without one are not drawn

    Attributes
    ----------
    drawable : all targets that may be drawn, as bits
    """

    REJECTIONS: Final = 6
    """Number of labels drawn without checking before the remaining ones are counted; both give the same
    distribution.
    """

    def __init__(self, members: Mapping[str, int], weights: Mapping[str, float]) -> None:
        self._bits = [members[label] for label in weights]
        self._weights = list(weights.values())
        self._sums = list(accumulate(self._weights))
        self.drawable = 0
        for bits in self._bits:
            self.drawable |= bits

    def draw(self, allowed: int, draws: Draws) -> int | None:
        """Return the position of one of the `allowed` targets (bits); None if none is left."""
        if not self._bits or not allowed:
            return None
        for _ in range(self.REJECTIONS):
            found = self._bits[draws.cumulative(self._sums)] & allowed
            if found:
                return draws.choice(_positions(found))
        left = [k for k, bits in enumerate(self._bits) if bits & allowed]
        if not left:
            return None
        return draws.choice(_positions(self._bits[draws.weighted(left, [self._weights[k] for k in left])] & allowed))


def apart_by_centres(scene: Scene, places: PlacesConfig) -> Stops:
    """Return the stops of a scene without computing geodesics. Two objects are apart if the horizontal distance between
    their centres is large enough.
    """
    ordered = sorted(scene.objects, key=lambda o: o.object_id)
    least = places.leaf_separation(scene.single_room)
    ground = np.array([o.center[[0, 2]] for o in ordered], dtype=np.float64).reshape(-1, 2)
    distance = np.linalg.norm(ground[:, None] - ground[None, :], axis=-1)
    return Stops(tuple(o.object_id for o in ordered), np.asarray(distance >= least))


def targets(
    referents: Mapping[str, Referents],
    rooms: Iterable[str],
    stops: Stops,
    sampling: SamplingConfig,
    words: Vocabulary,
) -> tuple[Target, ...]:
    """Return the objects of the given `rooms` that text can name and that can be reached, in order of room and object
    id.
    """
    alone = len(referents) == 1
    row_of = {name: k for k, name in enumerate(stops.object_ids)}
    chosen = [
        (room_id, int(i), row_of[referents[room_id].arrays.object_ids[i]])
        for room_id in sorted(rooms)
        for i in np.flatnonzero(referents[room_id].usable if alone else referents[room_id].usable_anywhere)
        if referents[room_id].arrays.object_ids[i] in row_of
    ]
    rows = [row for _, _, row in chosen]
    alike = _alike([(room_id, referents[room_id].arrays.labels[i]) for room_id, i, _ in chosen], words)
    apart = stops.apart[np.ix_(rows, rows)] & ~alike
    large = {referents[room_id].arrays.labels[i] for room_id, i, _ in chosen if not referents[room_id].small[i]}
    return tuple(
        Target(
            object_id=referents[room_id].arrays.object_ids[i],
            position=k,
            room_id=room_id,
            index=i,
            label=referents[room_id].arrays.labels[i],
            weight=1.0 if referents[room_id].arrays.labels[i] in large else sampling.small_target_weight,
            apart=_bits(apart[k]),
            alike=_bits(alike[k]),
            clear=_is_clear(referents[room_id], i, sampling),
        )
        for k, (room_id, i, _) in enumerate(chosen)
    )


def _alike(named: Sequence[tuple[str, str]], words: Vocabulary) -> NDArray[np.bool_]:
    """Return a mask (n, n) for n objects, given as (room, label): whether two of them are in different rooms and one
    word might name both.
    """
    meant = {label: words.overlapping(label) for _, label in named}
    found = [[room != other and label in meant[one] for other, label in named] for room, one in named]
    return np.array(found, dtype=bool).reshape(len(named), len(named))


def _is_clear(referents: Referents, index: int, sampling: SamplingConfig) -> bool:
    """Return whether an object has a name without a predicate, or a name whose predicate has a weight above 0."""
    groups = [GROUP_OF[q.predicate] for q in referents.qualifications[index]]
    return bool(referents.unique[index]) or any(getattr(sampling.predicates, group) > 0.0 for group in groups)


def _bits(row: NDArray[np.bool_]) -> int:
    return int.from_bytes(np.packbits(row, bitorder="little").tobytes(), "little")


def _positions(bits: int) -> list[int]:
    """Return the positions of the set bits, ascending."""
    found = []
    while bits:
        lowest = bits & -bits
        found.append(lowest.bit_length() - 1)
        bits ^= lowest
    return found

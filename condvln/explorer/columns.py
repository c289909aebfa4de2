"""The columns by which the page lists, filters and counts episodes. They have one entry per episode, and numbers in
place of names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from condvln.explorer.episode import episode_labels

__all__ = ["NAMED", "NUMBERS", "Columns"]

NAMED: Final = ("split", "source", "category", "composition", "observability")
"""Columns of names. A null is the name "unknown"."""
NUMBERS: Final = ("depth", "chain", "moves", "words", "route_length", "geodesic_distance")
UNKNOWN: Final = "unknown"


class Columns:
    """Collects one entry per episode."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, int]] = {name: {} for name in (*NAMED, "label", "predicate")}
        self._values: dict[str, list[Any]] = {
            name: [] for name in ("id", "scene", "group", "gold_label", "gold_leaf", "leaves", *NAMED, *NUMBERS)
        }
        self._labels: tuple[list[int], list[int]] = ([0], [])
        self._predicates: tuple[list[int], list[int]] = ([0], [])
        self._groups: dict[tuple[int, str], int] = {}

    def __len__(self) -> int:
        return len(self._values["id"])

    def add(self, row: Mapping[str, Any], scene: int) -> None:
        """Add an episode by its manifest row; `scene` is the number of its scene."""
        values = self._values
        values["id"].append(str(row["episode_id"]))
        values["scene"].append(scene)
        group = row["group_id"]
        # A group is within one scene, and its id is a name of that scene only.
        values["group"].append(-1 if group is None else self._groups.setdefault((scene, group), len(self._groups)))
        gold = next(leaf for leaf in row["leaves"] if leaf["leaf"] == row["gold_leaf"])
        values["gold_leaf"].append(gold["leaf"])
        values["leaves"].append(len(row["leaves"]))
        values["gold_label"].append(self._number("label", row["program"]["leaves"][gold["leaf"]]["moves"][-1]["label"]))
        for name in NAMED:
            values[name].append(self._number(name, self._named(row, name)))
        for name in NUMBERS:
            value = row[name]
            values[name].append(round(value, 2) if isinstance(value, float) else value)
        self._extend(self._labels, "label", episode_labels(row))
        asked = {
            "presence" if one["qualifier"] is None else one["qualifier"]["predicate"]
            for one in row["program"]["conditions"]
        }
        self._extend(self._predicates, "predicate", sorted(asked))

    def document(self) -> dict[str, Any]:
        """Return ``columns``, one entry per episode; ``names``, to which the numbers in the columns refer; ``lists``,
        the labels and predicates of all episodes, and the offsets at which those of each episode begin; and ``groups``,
        the number of counterfactual groups.
        """
        return {
            "names": {column: [*names] for column, names in self._names.items()},
            "columns": self._values,
            "lists": {
                "label": {"offsets": self._labels[0], "values": self._labels[1]},
                "predicate": {"offsets": self._predicates[0], "values": self._predicates[1]},
            },
            "groups": len(self._groups),
        }

    @staticmethod
    def _named(row: Mapping[str, Any], name: str) -> str:
        if name == "observability" and row[name] == "O0" and row.get("evidence_in_view"):
            return "O0f"
        return str(row[name]) if row[name] is not None else UNKNOWN

    def _number(self, column: str, name: str) -> int:
        names = self._names[column]
        return names.setdefault(name, len(names))

    def _extend(self, lists: tuple[list[int], list[int]], column: str, names: list[str]) -> None:
        lists[1].extend(self._number(column, name) for name in names)
        lists[0].append(len(lists[1]))

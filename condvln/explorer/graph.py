"""The relation graph of a scene, stored as columns; the page draws the part around a chosen object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

__all__ = ["graph_document"]

_METRICS: Final = ("used_distance", "surface_distance", "horizontal_distance", "azimuth", "elevation")
_SEMANTIC: Final = "semantic"


def graph_document(relations: Iterable[Mapping[str, Any]], objects: Iterable[str]) -> dict[str, Any]:
    """Return the edges between objects of a scene.

    Parameters
    ----------
    relations : rows of the table ``relations`` of the scene, points as lists
    objects : ids in the order of the plan; edges refer to them by number

    Returns
    -------
    ``predicates`` and, one entry per edge, ``subject``, ``target``, ``predicate`` (numbers), ``semantic``, ``in_text``,
    ``margin``, ``height`` (how much higher the subject's centre is, metres) and the metrics of the table by name.
    """
    numbers = {name: number for number, name in enumerate(objects)}
    predicates: dict[str, int] = {}
    names = ("subject", "target", "predicate", "semantic", "in_text", "margin", "height", *_METRICS)
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for row in relations:
        subject, target = numbers.get(row["subject"]), numbers.get(row["target"])
        if row["kind"] == "containment" or subject is None or target is None:
            continue
        columns["subject"].append(subject)
        columns["target"].append(target)
        columns["predicate"].append(predicates.setdefault(row["predicate"], len(predicates)))
        columns["semantic"].append(int(row["kind"] == _SEMANTIC))
        columns["in_text"].append(int(row["true_in_text"]))
        columns["margin"].append(_short(row["margin"], 2))
        columns["height"].append(None if row["delta"] is None else _short(-row["delta"][1], 3))
        for name in _METRICS:
            columns[name].append(_short(row[name], 3))
    return {"predicates": [*predicates], **columns}


def _short(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)

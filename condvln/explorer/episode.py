"""An episode as the page shows it. It is made from a manifest row, which may be read from a file or built from the
tables. Which words of the text state which condition and which stop is found by parsing the text with its own grammar.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from lark import Lark, Tree
from lark.exceptions import LarkError

from condvln.episodes.observability import places_at
from condvln.episodes.placing import heading_degrees
from condvln.explorer.evidence import SceneFacts
from condvln.instructions.grammar_source import grammar_source
from condvln.instructions.language import Language, Slot, language
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, VLN_CE
from condvln.scene.rotations import heading_of
from schemas.base import Json, Row
from schemas.program import Program

__all__ = ["UNPUBLISHED", "clauses", "episode_document", "episode_labels"]

UNPUBLISHED: Final = "not exported"
"""Split of an episode that is in the snapshot and in no split of the export."""


def episode_document(row: Row, *, facts: SceneFacts | None = None, certificate: Row | None = None) -> Json:
    """Return an episode's document.

    Parameters
    ----------
    row : a row of a manifest, as `condvln.manifest.manifest_row` makes it or as JSON; points are lists or have x, y, z
    facts : relations of its scene; without them the page shows no measures
    certificate : its line of ``certificates/<split>.jsonl``
    """
    program = Program.model_validate(row["program"])
    start = _point(row["start_position"])
    rotation = _point(row["start_rotation"])
    heading = heading_degrees(heading_of(rotation))
    place = dict(zip("xyz", start, strict=True))
    return {
        "id": str(row["episode_id"]),
        "group": row["group_id"],
        "source": row["source"],
        "scene": row["scene_id"],
        "split": row["split"],
        "category": row["category"],
        "composition": row["composition"],
        "observability": row["observability"],
        "in_view": row["evidence_in_view"],
        "approximate": row["observability_approximate"],
        "evidence": [dict(one) for one in row["evidence"] or ()],
        "moves": row["moves"],
        "words": row["words"],
        "text": row["instruction_text"],
        "clauses": clauses(row["instruction_text"], program),
        "program": program.model_dump(mode="json"),
        "route": list(program.route()[0]),
        "gold": row["gold_leaf"],
        "start": start,
        "heading": round(heading, 1),
        "leaves": [_leaf(leaf) for leaf in sorted(row["leaves"], key=lambda leaf: leaf["leaf"])],
        "looking": None
        if row["looking_path"] is None
        else {"path": [_point(corner) for corner in row["looking_path"]], "length": row["looking_length"]},
        "success_distance": row["success_distance"],
        "max_steps": row["max_steps"],
        "geodesic_distance": row["geodesic_distance"],
        "route_length": row["route_length"],
        "facts": None if facts is None else [facts.of(condition, place, heading) for condition in program.conditions],
        "certificate": None if certificate is None else _certificate(certificate),
        "frames": [],
        "views": _decisions(row, program, heading),
    }


def episode_labels(row: Row) -> list[str]:
    """Return the sorted labels that an episode's program names: conditions, anchors and stops."""
    program = row["program"]
    named: set[str] = set()
    moves = [move for leaf in program["leaves"] for move in leaf["moves"]]
    for one in (*program["conditions"], *moves):
        named.add(one["label"])
        qualifier = one["qualifier"]
        if qualifier is not None:
            named |= {anchor["label"] for anchor in qualifier.get("anchors") or ()}
    return sorted(named)


def _leaf(leaf: Row) -> Json:
    return {
        "leaf": leaf["leaf"],
        "object": leaf["object_id"],
        "goals": [_point(goal) for goal in leaf["goals"]],
        "stops": [{"object": stop["object_id"], "at": _point(stop["position"])} for stop in leaf["subgoals"]],
        "path": [_point(corner) for corner in leaf["reference_path"]],
        "geodesic_distance": leaf["geodesic_distance"],
        "route_length": leaf["route_length"],
    }


def _decisions(row: Row, program: Program, heading: float) -> Json:
    """Return, by condition of the gold route, where the looking walk decides it: the number of the `frame`, the place
    ``at``, ``walked``, the metres walked until then, and the heading in degrees clockwise from north.
    """
    found = {}
    for k, frame in zip(dict.fromkeys(program.route()[0]), row["looking_decided"] or (), strict=False):
        taken = row["looking_actions"][:frame]
        walked = VLN_CE.forward * taken.count(FORWARD)
        turned = VLN_CE.turn * (taken.count(RIGHT) - taken.count(LEFT))
        at = places_at(np.array([_point(corner) for corner in row["looking_path"]]), np.array([walked]))[0]
        found[str(k)] = {
            "frame": frame,
            "at": at.round(3).tolist(),
            "walked": round(walked, 2),
            "heading": round((heading + turned) % 360.0, 1),
        }
    return found


def _certificate(line: Row) -> Json:
    checked = line.get("checked") or {}
    return {
        "proven": line.get("proven"),
        "facts": sum(checked.values()),
        "kinds": len(checked),
        "conditions": line.get("conditions") or [],
        "disagreements": line.get("disagreements") or [],
    }


def _point(value: Row | Sequence[float]) -> list[float]:
    if isinstance(value, Mapping):
        return [float(value[axis]) for axis in ("x", "y", "z", "w") if axis in value]
    return [float(number) for number in value]


LANGUAGES: Final = ("en", "es")
Span = tuple[int, int]
Clause = tuple[int, int, int, int]
"""Beginning and end in the text, index of the condition or −1, index of the leaf or −1."""


def clauses(text: str, program: Program) -> list[Clause]:
    """Return the clauses of a text from its first word to its last; an empty list if no grammar of ours can parse the
    text.

    A clause of a condition is a statement, a question or an answer; a clause of a leaf has all its stops.
    """
    for code in LANGUAGES:
        lowered = text.lower()
        if len(lowered) != len(text):  # a position in the lowered text would be another one in the text
            continue
        whole, places = _expanded(lowered, language(code))
        try:
            tree = _parser(code).parse(whole)
        except LarkError:
            continue
        return _apart(sorted(_found(tree, program, code)), places)
    return []


def _expanded(text: str, words: Language) -> tuple[str, list[Span]]:
    """Return the expanded text, as :meth:`Language.expanded` does, and for each character of the expanded text the span
    of `text` that the character stands for: one character, or a whole contraction ("del" is parsed as "de el").
    """
    apart = {together: one for one, together in words.contractions.items()}
    whole, places, done = "", [], 0
    for found in re.finditer(rf"\b({'|'.join(apart)})\b", text) if apart else ():
        whole += text[done : found.start()] + apart[found[0]]
        places += [(k, k + 1) for k in range(done, found.start())]
        places += [found.span()] * len(apart[found[0]])
        done = found.end()
    return whole + text[done:], places + [(k, k + 1) for k in range(done, len(text))]


def _apart(parsed: list[Clause], places: list[Span]) -> list[Clause]:
    """Convert clauses of the expanded text to clauses of the original text. `places` has the span in the original text
    of each character. A contraction that two clauses share belongs to the earlier clause.
    """
    found, done = [], 0
    for start, end, condition, leaf in parsed:
        begin, done = max(done, places[start][0]), places[end - 1][1]
        found.append((begin, done, condition, leaf))
    return found


@cache
def _parser(code: str) -> Lark:
    return Lark(grammar_source(language(code)), parser="lalr", propagate_positions=True)


def _found(tree: Tree[Any], program: Program, code: str) -> Iterator[Clause]:
    body = next(tree.find_data("body")).children[0]
    category, number = str(body.data).rsplit("_", 1)
    if category != program.category:
        return
    slots = [
        piece for piece in language(code).templates[program.category][int(number)].pieces if isinstance(piece, Slot)
    ]
    parts = [child for child in body.children if isinstance(child, Tree)]
    if len(slots) != len(parts):
        return
    for slot, part in zip(slots, parts, strict=True):
        if part.meta.empty:
            continue
        leaf = slot.form == "leaf"
        yield part.meta.start_pos, part.meta.end_pos, -1 if leaf else slot.index, slot.index if leaf else -1

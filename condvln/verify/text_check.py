"""Check text against program and scene: the text's conditions, the truth of the conditions in the scene, and the gold
leaf.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from functools import lru_cache
from typing import Final

from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.files import UnplacedText
from condvln.verify.phrases import Moves, Named, Phrase
from condvln.verify.predicates import DIRECTIONS
from condvln.verify.program_check import leaf_of
from condvln.verify.referents import Answer, Problem, Referent, SceneReferents
from condvln.verify.standpoint import BEARINGS, COMPASS, Standpoint, heading_of, yaw_of
from condvln.verify.text_reader import TextReading, Unreadable, read
from schemas.config.constants import HEADING_TOLERANCE
from schemas.evaluation import ManifestEpisode
from schemas.program import Category, Condition, ObjectRef, Program, asked_in

__all__ = ["check_meaning"]

_NO_START: Final = "the text has no start, so it is unknown what is left, right, ahead or behind"


def check_meaning(
    row: ManifestEpisode | UnplacedText, referents: SceneReferents, rules: VerifierRules, certificate: Certificate
) -> None:
    """Check every property of an episode that follows from its text and the scene, without navmesh and paths."""
    certificate.same("words", row.words, len(row.instruction_text.split()))
    _check_rooms(row.program, referents, certificate)
    try:
        reading = read(row.instruction_text, rules.language)
    except Unreadable as fault:
        certificate.holds("text_reading", False, "one reading", str(fault))
        return
    certificate.holds("text_reading", True, None, None)
    _check_heading(row, reading, rules, certificate)
    order = _check_conditions(row.program, reading, referents.single_room, certificate)
    if order is None:
        return
    said = [reading.leads[place] for place in order]
    leads = {branch.condition: branch.lead for branch in row.program.branches if branch.lead is not None}
    claimed = [Named(leads[k].label, leads[k].anchor_label) if k in leads else None for k in range(len(order))]
    certificate.same("leads", claimed, said)
    start = Standpoint.of(row) if isinstance(row, ManifestEpisode) else None
    unknown: Set[str] = BEARINGS.keys() if isinstance(row, UnplacedText) else frozenset()
    if not unknown.isdisjoint(_said(reading)):
        certificate.unproven.update(dict.fromkeys(("condition_truth", "referents", "gold_leaf"), _NO_START))
    truths = _check_claims(row.program, reading, order, referents, start, unknown, certificate)
    leaves = _check_branches(row.program, reading, order, referents.single_room, certificate)
    if leaves is None:
        return
    _check_stops(row.program, leaves, referents, start, unknown, certificate)
    if truths is not None:
        case = sum(1 << place for place, truth in zip(order, truths, strict=True) if truth)
        certificate.same("gold_leaf", row.gold_leaf, leaves.index(reading.moves[case]))


def _check_rooms(program: Program, referents: SceneReferents, certificate: Certificate) -> None:
    for room_id, label in sorted({(one.room.room_id, one.room.label) for one in program.named}):
        view = referents.rooms.get(room_id)
        certificate.same("room_named", label, None if view is None else view.label, room_id)


def _check_heading(
    row: ManifestEpisode | UnplacedText, reading: TextReading, rules: VerifierRules, certificate: Certificate
) -> None:
    said = _said(reading)
    directed = not said.isdisjoint(DIRECTIONS)
    used = {"compass"} if directed else set()
    used |= set() if said.isdisjoint(BEARINGS) else {"egocentric"}
    certificate.holds("directions", used <= {rules.directions}, rules.directions, sorted(used))
    if not isinstance(row, ManifestEpisode):
        certificate.holds("heading", reading.heading is None, "no start", reading.heading)
        return
    if directed and rules.text.preamble:
        certificate.holds("heading_stated", reading.heading is not None, "compass words", "no heading")
    yaw = yaw_of(row.start_rotation)
    if reading.heading is not None and yaw is not None:
        off = (heading_of(yaw) - COMPASS[reading.heading] + 180.0) % 360.0 - 180.0
        certificate.holds("heading", abs(off) <= HEADING_TOLERANCE, reading.heading, round(heading_of(yaw), 3))


def _said(reading: TextReading) -> set[str]:
    """Return the predicates of all qualifiers of a text."""
    phrases = [*reading.conditions, *(stop for moves in reading.moves for stop in moves)]
    return {phrase.qualifier[0] for phrase in phrases if phrase.qualifier is not None}


def _check_conditions(
    program: Program, reading: TextReading, single_room: bool, certificate: Certificate
) -> list[int] | None:
    """Return for each condition of the program its index among the text's conditions; None if program and text do not
    have the same conditions.
    """
    claimed = [_phrase(condition, single_room) for condition in program.conditions]
    said = [_unplaced(phrase, single_room) for phrase in reading.conditions]
    agreed = len(claimed) == len(said) == len(set(said)) and set(claimed) == set(said)
    if not certificate.holds("text_conditions", agreed, claimed, said):
        return None
    return [said.index(phrase) for phrase in claimed]


def _check_branches(
    program: Program, reading: TextReading, order: Sequence[int], single_room: bool, certificate: Certificate
) -> list[Moves] | None:
    """Return the text's stops for each leaf of the program. If these stops differ from the program's, record this and
    return None.
    """
    claimed = [tuple([_phrase(move, single_room) for move in leaf.moves]) for leaf in program.leaves]
    words: dict[int, Moves] = {}
    for (truths, leaf), moves in zip(_cases(program.category, tuple(order)), reading.moves, strict=True):
        if words.get(leaf) is not moves:
            said = tuple([_unplaced(stop, single_room) for stop in moves]) if single_room else moves
            if said != claimed[leaf]:
                certificate.holds("text_branches", False, claimed[leaf], said, f"truths {truths}")
                return None
            words[leaf] = moves
    certificate.holds("text_branches", True, None, None)
    return [words[leaf] for leaf in range(len(claimed))]


@lru_cache(maxsize=256)
def _cases(category: Category, order: tuple[int, ...]) -> tuple[tuple[tuple[bool, ...], int], ...]:
    """Return (truths of the program's conditions, its leaf) for each case of a text's conditions. `order` has the index
    among these of each condition of the program.
    """
    cases = range(1 << len(order))
    truths = [tuple(bool(case >> place & 1) for place in order) for case in cases]
    return tuple([(those, leaf_of(category, those)) for those in truths])


def _check_claims(
    program: Program,
    reading: TextReading,
    order: Sequence[int],
    referents: SceneReferents,
    start: Standpoint | None,
    unknown: Set[str],
    certificate: Certificate,
) -> list[bool] | None:
    """Return the truths of the program's conditions in the scene; None if one can't be decided, such as one by a
    predicate that is `unknown`.
    """
    truths: list[bool] = []
    for k, (condition, place) in enumerate(zip(program.conditions, order, strict=True)):
        name = f"condition {k}"
        if condition.qualifier is not None and condition.qualifier.predicate in unknown:
            continue
        answer = referents.claim(reading.conditions[place], start)
        if isinstance(answer, Problem):
            certificate.holds(answer.fact, False, answer.needed, answer.found, f"{name} ({reading.conditions[place]})")
            continue
        certificate.holds("condition_decided", True, None, None)
        if condition.qualifier is not None:
            asked = asked_in(referents.scene.family)
            certificate.holds("predicate_asked", condition.qualifier.predicate in asked, "asked", "not asked", name)
        certificate.same("condition_definite", condition.definite, answer.definite, name)
        certificate.same("condition_truth", condition.truth, answer.truth, name)
        certificate.same("witnesses", sorted(condition.witnesses), sorted(answer.witnesses), name)
        certificate.same("condition_referents", _ids(condition), _found_ids(answer), name)
        certificate.conditions.append(
            {
                "condition": str(reading.conditions[place]),
                "truth": answer.truth,
                "witnesses": sorted(answer.witnesses),
                "numbers": dict(answer.numbers),
            }
        )
        truths.append(answer.truth)
    return truths if len(truths) == len(program.conditions) else None


def _check_stops(
    program: Program,
    leaves: Sequence[Moves],
    referents: SceneReferents,
    start: Standpoint | None,
    unknown: Set[str],
    certificate: Certificate,
) -> None:
    """Check that every stop of the text refers to exactly one object, and that the program names the same object."""
    for k, (leaf, moves) in enumerate(zip(program.leaves, leaves, strict=True)):
        for j, (move, stop) in enumerate(zip(leaf.moves, moves, strict=True)):
            if stop.qualifier is not None and stop.qualifier[0] in unknown:
                continue
            found = referents.thing(stop, start)
            if isinstance(found, Problem):
                name = f"leaf {k} stop {j} ({stop})"
                certificate.holds(found.fact, False, found.needed, found.found, name)
                continue
            if move.is_bearing:
                # The text does not name the stop's room. The program's name for the room must be valid nevertheless.
                found = _with_room(found, move, referents)
            claimed, own = (move.object_id, *_ids(move)), (found.object_id, *_found_ids(found))
            certificate.same("referents", claimed, own, f"leaf {k} stop {j}")


def _with_room(found: Referent, move: ObjectRef, referents: SceneReferents) -> Referent:
    room = referents.room(None if referents.single_room else Named(move.room.label, move.room.anchor_label))
    if isinstance(room, Problem) or room[0].room.room_id != found.room_id:
        return found
    return found._replace(room_anchor_id=room[1])


def _phrase(named: Condition | ObjectRef, single_room: bool) -> Phrase:
    """Return the phrase by which the text must name a condition or stop of the program."""
    qualifier = None if named.qualifier is None else (named.qualifier.predicate, named.qualifier.anchor_labels)
    # A stop with an egocentric direction is in the room of the start.
    unnamed = single_room or (isinstance(named, ObjectRef) and qualifier is not None and qualifier[0] in BEARINGS)
    room = None if unnamed else Named(named.room.label, named.room.anchor_label)
    return Phrase(named.label, qualifier, room, isinstance(named, Condition) and named.definite)


def _unplaced(phrase: Phrase, single_room: bool) -> Phrase:
    """Return `phrase`, but without its room if the scene has only a single room: a text need not name that room."""
    return phrase._replace(room=None) if single_room and phrase.room is not None else phrase


def _ids(named: Condition | ObjectRef) -> tuple[str | None, ...]:
    anchors = () if named.qualifier is None else named.qualifier.anchor_ids
    return named.room.room_id, named.room.anchor_id, *anchors


def _found_ids(found: Answer | Referent) -> tuple[str | None, ...]:
    return found.room_id, found.room_anchor_id, *found.anchor_ids

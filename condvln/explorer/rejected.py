"""Examples of candidates that a rule rejected: in words, with the objects that the rule is about."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import islice
from typing import Final

from condvln.episodes import candidates
from condvln.instructions import degeneracy
from condvln.instructions.degeneracy import Claim, Presupposed, clash
from condvln.labels import vocabulary
from schemas.base import Json
from schemas.program import Condition, ObjectRef, Program

__all__ = ["REASONS", "clash_examples", "program_example", "rule_text"]

CLASHES: Final = frozenset(
    ("tautology", "implied", "one_label", "given_away", "names_stop", "circular", "two_things")
)  # fmt: skip
"""Rules by which a condition does not fit the stops or the other conditions of a program."""
REASONS: Final[Mapping[str, Mapping[str, str]]] = {
    candidates.DRAWING: degeneracy.REASONS,
    candidates.PLACING: candidates.REASONS,
}
"""What each reason of rejection means, by stage."""
TRIED: Final = 20
"""Number of programs of a scene in which an example of a rule is looked for."""


def rule_text(stage: str, reason: str) -> str:
    """Return in words the rule by which a stage rejects; empty for an unknown one."""
    return REASONS.get(stage, {}).get(reason, "")


def program_example(program: Program) -> Json:
    """Return a rejected candidate in words, ``example``, and the ids of its goals and stops, ``objects``."""
    asked = ", ".join(_condition(one) for one in program.conditions)
    leaves = "; ".join(
        f"leaf {k}: {' then '.join(_stop(move) for move in leaf.moves)}" for k, leaf in enumerate(program.leaves)
    )
    objects = dict.fromkeys(move.object_id for leaf in program.leaves for move in leaf.moves)
    return {"example": f"{program.category}: asks for {asked}; {leaves}", "objects": [*objects]}


def clash_examples(programs: Mapping[str, Program], reasons: Collection[str]) -> dict[str, Json]:
    """Return, by reason, a condition that can be asked in the scene and that the rule rejects in one of its programs.

    The sampler counts its own draws and keeps none. So each condition that some program of the scene asks is tried in
    the place of the conditions of others, short programs first, until each rule has an example.

    Parameters
    ----------
    programs : candidates of one scene by id
    reasons : those of which an example is wanted; reasons that are no such rule have none
    """
    found: dict[str, Json] = {}
    wanted = CLASHES & set(reasons)
    ordered = [programs[name] for name in sorted(programs, key=lambda name: (_length(programs[name]), name))]
    asked = dict.fromkeys(_bare(one) for program in ordered for one in program.conditions)
    for program in islice(ordered, TRIED):
        stops = [move for leaf in program.leaves for move in leaf.moves]
        given = Presupposed.by(stops)
        for condition in asked:
            if wanted <= found.keys():
                return found
            own = [one for one in program.conditions[1:] if _bare(one) != condition]
            rule = clash(Claim.of(condition), [Claim.of(one) for one in own], given, vocabulary)
            if rule in wanted and rule not in found:
                found[rule] = _clash(condition, own, stops)
    return found


def _clash(condition: Condition, others: Sequence[Condition], stops: Sequence[ObjectRef]) -> Json:
    beside = [f"stops {', '.join(dict.fromkeys(_stop(stop) for stop in stops))}"]
    beside += [f"conditions {', '.join(_condition(one) for one in others)}"] if others else []
    anchors = condition.qualifier.anchor_ids if condition.qualifier is not None else ()
    objects = dict.fromkeys((*anchors, *(stop.object_id for stop in stops)))
    return {"example": f"{_condition(condition)}, beside the {' and the '.join(beside)}", "objects": [*objects]}


def _length(program: Program) -> int:
    return len(program.conditions) + sum(len(leaf.moves) for leaf in program.leaves)


def _bare(condition: Condition) -> Condition:
    """Return the condition without its truth and witnesses, which rules do not look at."""
    return condition.model_copy(update={"truth": False, "witnesses": ()})


def _condition(one: Condition) -> str:
    anchors = "" if one.qualifier is None else f" {one.qualifier.predicate} {' and '.join(one.qualifier.anchor_labels)}"
    return f"{one.label}{anchors.rstrip()} in {one.room.label} ({one.room.room_id})"


def _stop(stop: ObjectRef) -> str:
    return f"{stop.label} ({stop.object_id})"

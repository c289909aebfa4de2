"""What a program claims of a condition is compared with text and scene, field by field: one that is wrong alone breaks
the fact of its name, in whichever condition it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from condvln.verify import proof
from condvln.verify.certificate import Certificate
from condvln.verify.surfaces import Shapes
from condvln.verify.text_check import check_meaning
from schemas.program import Condition

CHANGES: dict[str, Callable[[Condition], dict[str, Any]]] = {
    "condition_truth": lambda condition: {"truth": not condition.truth},
    "text_conditions": lambda condition: {"definite": not condition.definite},
    "witnesses": lambda condition: {"witnesses": (*condition.witnesses, "nothing")},
    "condition_referents": lambda condition: {"room": condition.room.model_copy(update={"room_id": "nowhere"})},
}


@pytest.fixture(scope="module")
def asked(made_export) -> list[tuple[Any, ...]]:
    """The arguments of `check_meaning` for each episode of a scene, without the certificate."""
    calls: list[tuple[Any, ...]] = []
    run = made_export.runs[0]
    scene = made_export.scenes[run.scene_id]
    certificates = [Certificate(row.manifest.episode_id, run.source, run.scene_id, row.split) for row in run.rows]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proof, "check_meaning", lambda *arguments: calls.append(arguments[:3]))
        surfaces = lambda: made_export.surfaces[run.scene_id]  # noqa: E731
        proof.prove_scene(
            run.rows, certificates, scene, surfaces, made_export.folder, made_export.rules, Shapes(scene.root)
        )
    assert len(calls) == len(run.rows) > 5
    return calls


def broken(row: Any, referents: Any, rules: Any) -> set[str]:
    """The facts that do not hold."""
    certificate = Certificate(row.episode_id, row.source, row.scene_id, "train")
    check_meaning(row, referents, rules, certificate)
    return {one.fact for one in certificate.disagreements}


@pytest.mark.parametrize("fact", CHANGES)
def test_a_field_that_is_wrong_alone_breaks_its_fact(asked: list[tuple[Any, ...]], fact: str) -> None:
    for row, *others in asked:
        assert broken(row, *others) == set()
        for k, condition in enumerate(row.program.conditions):
            # Copies are not validated: the schema would refuse most of these programs before.
            wrong = [*row.program.conditions]
            wrong[k] = condition.model_copy(update=CHANGES[fact](condition))
            program = row.program.model_copy(update={"conditions": tuple(wrong)})
            assert fact in broken(row.model_copy(update={"program": program}), *others)

"""What a row tells of its evidence agrees with its program and with itself."""

from __future__ import annotations

from condvln.verify.certificate import Certificate
from condvln.verify.program_check import check_program
from schemas.evaluation import ManifestEpisode

LEVELS = ("O0", "O1", "O2")


def places(row: ManifestEpisode, **changes: object) -> list[str]:
    """Where a row's axes are refuted."""
    certificate = Certificate(row.episode_id, row.source, row.scene_id, row.split)
    check_program(row.model_copy(update=changes), certificate)
    return [d.place for d in certificate.disagreements if d.fact == "axes"]


def test_published_evidence_agrees(made_export) -> None:
    levels = set()
    for row in made_export.rows:
        assert places(row.manifest) == []
        levels.add(row.manifest.observability)
    assert len(levels) > 1


def test_another_level_condition_or_view_is_refuted(made_export) -> None:
    for row in (row.manifest for row in made_export.rows[:40]):
        for level in LEVELS:
            if level != row.observability:
                assert places(row, observability=level) == ["evidence"]
        assert places(row, evidence_in_view=not row.evidence_in_view) == ["evidence"]
        first = row.evidence[0]
        absent = {*range(len(row.program.conditions) + 1)} - set(row.program.route()[0])
        moved = first.model_copy(update={"condition": max(absent)})
        assert places(row, evidence=(moved, *row.evidence[1:])) == ["evidence"]
        assert places(row, evidence=row.evidence[1:])
        assert places(row, observability=None) == ["evidence"]
        assert places(row, observability=None, evidence=None) == []
        far = [e.model_copy(update={"in_view": True, "observability": "O2"}) for e in row.evidence]
        assert places(row, evidence=tuple(far), observability="O2", evidence_in_view=True) == ["evidence"]

"""The export's files read side by side, and what only shows over all of them."""

from __future__ import annotations

import gzip
import json
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path

import orjson
import pytest

from condvln.episodes.identity import numeric_id
from condvln.verify.certificate import Certificate
from condvln.verify.corpus import Corpus
from condvln.verify.files import ExportFiles
from schemas.errors import FormatError, MissingFileError


@pytest.fixture
def export(made_export, tmp_path: Path) -> Path:
    """A copy to break."""
    return Path(shutil.copytree(made_export.folder, tmp_path / "export"))


def split_of(export: Path) -> str:
    return next(p.stem for p in sorted((export / "manifest").glob("*.jsonl")) if p.stat().st_size)


def rewrite(path: Path, change) -> None:
    """Read a gzip document, change it, write it in another formatting."""
    document = json.loads(gzip.decompress(path.read_bytes()))
    change(document)
    path.write_bytes(gzip.compress(json.dumps(document, indent=1).encode()))


def test_each_scene_comes_once_with_all_that_belongs_to_its_rows(made_export) -> None:
    names = [(run.source, run.scene_id) for run in made_export.runs]
    assert names == sorted(set(names))
    lines = [p.read_bytes().splitlines() for p in (made_export.folder / "manifest").glob("*.jsonl")]
    assert len(made_export.rows) == sum(map(len, lines))
    for row in made_export.rows:
        assert row.truth is not None
        assert row.record["episode_id"] == row.manifest.episode_id


def test_records_in_another_order_are_found(export: Path, made_export) -> None:
    split = split_of(export)
    rewrite(export / "vlnce" / split / f"{split}.json.gz", lambda d: d["episodes"].reverse())
    files = ExportFiles(export)
    rows = [row for run in files.runs() for row in run.rows]
    assert len(rows) == len(made_export.rows)
    assert all(row.record is not None and row.record["episode_id"] == row.manifest.episode_id for row in rows)
    assert not files.unread


@pytest.mark.parametrize(("variant", "fact"), [("vlnce", "record"), ("vlnce_looking", "looking_record")])
def test_a_missing_and_a_foreign_record_are_told(export: Path, variant: str, fact: str) -> None:
    split = split_of(export)

    def change(document) -> None:
        document["episodes"][0]["episode_id"] = "foreign"

    rewrite(export / variant / split / f"{split}.json.gz", change)
    files = ExportFiles(export)
    rows = [row for run in files.runs() for row in run.rows]
    assert [getattr(row, fact) for row in rows].count(None) == 1
    assert [(entry.episode_id, entry.fact) for entry in files.unread] == [("foreign", fact)]


def test_a_line_that_is_no_row_is_told(export: Path) -> None:
    split = split_of(export)
    path = export / "manifest" / f"{split}.jsonl"
    lines = path.read_bytes().splitlines()
    row = orjson.loads(lines[0])
    row["program"]["conditions"][0]["truth"] = "perhaps so"
    path.write_bytes(b"\n".join([orjson.dumps(row), *lines[1:]]) + b"\n")
    files = ExportFiles(export)
    list(files.runs())
    assert [(e.episode_id, e.fact) for e in files.unread if e.fact == "readable"] == [("line 1", "readable")]


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.99])
def test_a_cut_document_is_an_error(export: Path, keep: float) -> None:
    split = split_of(export)
    path = export / "vlnce" / split / f"{split}.json.gz"
    whole = gzip.decompress(path.read_bytes())
    path.write_bytes(gzip.compress(whole[: int(keep * whole.index(b'],"instruction_vocab"'))]))
    with pytest.raises(FormatError):
        list(ExportFiles(export).runs())


def test_no_export_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no manifest"):
        ExportFiles(tmp_path)


# -- over all episodes -------------------------------------------------------------------------------------------------


def disagreements(rows) -> list[list[str]]:
    """Facts that disagree, row by row; rows as (split, manifest)."""
    corpus, found = Corpus(), []
    for split, row in rows:
        certificate = Certificate(row.episode_id, row.source, row.scene_id, split)
        corpus.check(row, split, certificate)
        found.append(sorted(d.fact for d in certificate.disagreements))
    return found


def test_a_sound_corpus(made_export) -> None:
    assert not any(disagreements((row.split, row.manifest) for row in made_export.rows))


def test_an_id_is_that_of_its_hash(made_export) -> None:
    row = made_export.rows[0].manifest
    assert disagreements([(row.split, row)])[0] == []
    off = row.model_copy(update={"episode_id": int(row.episode_id) + 1})
    assert disagreements([(row.split, off)])[0] == ["id_of_hash"]


def test_repeats_are_found(made_export) -> None:
    row = made_export.rows[0].manifest.model_copy(update={"split": "train", "group_id": None})
    other = row.model_copy(update={"episode_id": numeric_id("other"), "episode_hash": "other"})
    assert disagreements([("train", row), ("train", row)])[1] == ["unique_id"]
    assert disagreements([("train", row), ("train", other)])[1] == ["program_once", "unique_episode"]


def test_a_scene_in_two_groups_of_splits_is_found(made_export) -> None:
    one, other = (row.manifest for row in made_export.runs[0].rows[:2])
    one, other = (row.model_copy(update={"group_id": None}) for row in (one, other))

    def of(split, row):
        return split, row.model_copy(update={"split": split})

    assert not disagreements([of("train", one), of("val_seen", other)])[1]
    for split in ("val_unseen", "test"):
        assert disagreements([of("train", one), of(split, other)])[1] == ["split_leakage"]


def test_a_program_in_two_splits_is_found(made_export) -> None:
    row = made_export.rows[0].manifest.model_copy(update={"split": "train", "group_id": None})
    moved = {
        "episode_id": numeric_id("other"),
        "episode_hash": "other",
        "split": "val_seen",
        "start_position": (9.0, 0.0, 9.0),
    }
    found = disagreements([("train", row), ("val_seen", row.model_copy(update=moved))])
    assert found[1] == ["program_leakage", "program_once"]


def group_of(row):
    """The four members of a counterfactual group made from one row: all but the id and what must differ is shared."""
    program = row.program
    condition = program.conditions[0]
    twin = condition.model_copy(update={"truth": not condition.truth, "witnesses": () if condition.truth else ("w",)})
    members = []
    for turned, exchanged in product((False, True), repeat=2):
        leaves = (program.leaves[1], program.leaves[0], *program.leaves[2:]) if exchanged else program.leaves
        conditions = (twin if turned else condition, *program.conditions[1:])
        own = program.model_copy(update={"conditions": conditions, "leaves": leaves})
        name = f"member {turned} {exchanged}"
        update = {
            "episode_id": numeric_id(name),
            "episode_hash": name,
            "instruction_text": name,
            "group_id": "g",
            "split": "train",
            "program": own,
        }
        members.append(row.model_copy(update=update))
    return members


def test_a_group_shares_all_that_it_must(made_export) -> None:
    members = group_of(made_export.rows[0].manifest)
    assert not any(disagreements(("train", member) for member in members))
    x, y, z = members[0].start_position
    for change in (
        {"max_steps": members[0].max_steps - 1},
        {"start_position": (x + 0.001, y, z)},
        {"start_rotation": (0.0, 0.0, 0.0, 1.0001)},
        {"category": "other"},
    ):
        broken = [*members[:3], members[3].model_copy(update=change)]
        assert disagreements(("train", member) for member in broken)[3] == ["group"]


def test_a_group_differs_in_one_condition_and_two_leaves(made_export) -> None:
    long = next(row.manifest for row in made_export.rows if len(row.manifest.program.leaves) == 4)
    members = group_of(long)
    conditions, leaves = members[0].program.conditions, members[0].program.leaves
    for change in (
        {"conditions": conditions[::-1]},
        {"leaves": (leaves[1], leaves[2], leaves[0], leaves[3])},
        {"leaves": (leaves[0], leaves[1], leaves[2], leaves[0])},
    ):
        broken = [members[0], members[1].model_copy(update={"program": long.program.model_copy(update=change)})]
        assert "group" in disagreements(("train", member) for member in broken)[1]


def test_the_verifier_runs_none_of_the_code_that_it_verifies() -> None:
    """Beside the import contract: nothing of it is in the process either."""
    code = (
        "import sys, condvln.verify, condvln.verify.proof; from condvln.verify import read;"
        "read('If there is a lamp, go to the sofa. Otherwise, go to the desk.');"
        "print([m for m in sys.modules if m.startswith(('condvln.relations', 'condvln.instructions',"
        " 'condvln.episodes', 'ray'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

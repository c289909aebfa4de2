"""A whole export: loads in strict loaders, repeats to the byte, and leaves nothing half-written."""

from __future__ import annotations

import errno
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.export.snapshot import export_snapshot
from condvln.export.splits import SPLITS
from condvln.export.tables import FolderTables, rows_of
from condvln.export.tokens import tokenize
from condvln.formats import streams
from schemas.config import SplitsConfig
from schemas.errors import FormatError, MissingFileError, StoreError
from schemas.evaluation import ManifestEpisode
from schemas.tables import EPISODES, INSTRUCTIONS, SCENES
from schemas.vlnce import GroundTruth, VlnCeDocument
from tests.condvln.export.conftest import linear_text
from tests.made_snapshot import MemoryTables, made_rows, made_scene, made_snapshot
from tests.strict_loader import AnsrEpisode, Episode, load_split, read


def hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def manifest_of(folder: Path, split: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "manifest" / f"{split}.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("split", SPLITS)
def test_every_variant_loads_in_a_strict_loader(exported: Path, split: str) -> None:
    stock = load_split(exported / "vlnce" / split / f"{split}.json.gz")
    oracle = load_split(exported / "oracle" / split / f"{split}.json.gz")
    ansr = load_split(exported / "ansr" / split / f"{split}.json.gz", AnsrEpisode)
    assert [e.episode_id for e in stock] == [e.episode_id for e in oracle] == [e.episode_id for e in ansr]
    assert stock
    with pytest.raises(TypeError):
        load_split(exported / "ansr" / split / f"{split}.json.gz", Episode)


@pytest.mark.parametrize("split", SPLITS)
def test_documents_and_ground_truth_are_those_of_the_schema(exported: Path, split: str) -> None:
    document = VlnCeDocument.model_validate(read(exported / "vlnce" / split / f"{split}.json.gz"))
    truths = read(exported / "vlnce" / split / f"{split}_gt.json.gz")
    assert set(truths) == {str(episode.episode_id) for episode in document.episodes}
    for episode in document.episodes:
        truth = GroundTruth.model_validate(truths[str(episode.episode_id)])
        assert truth.locations[0] == episode.start_position == episode.reference_path[0]
        steps = np.linalg.norm(np.diff(np.array(truth.locations), axis=0), axis=1)
        assert steps.max() <= 0.25 + 0.002  # the rounding of both ends to 1 mm
        assert len(truth.locations) == (truth.forward_steps or 0) + 1
        if truth.actions is not None:
            assert truth.forward_steps == truth.actions.count(1)
        else:
            assert truth.locations[-1] == episode.reference_path[-1]
        assert np.linalg.norm(episode.start_rotation) == pytest.approx(1.0, abs=1e-6)
        assert max(episode.instruction.instruction_tokens or []) < document.instruction_vocab.num_vocab


@pytest.mark.parametrize("split", SPLITS)
def test_the_twins_differ_where_they_should_and_nowhere_else(exported: Path, split: str) -> None:
    stock = read(exported / "vlnce" / split / f"{split}.json.gz")
    oracle = read(exported / "oracle" / split / f"{split}.json.gz")
    ansr = read(exported / "ansr" / split / f"{split}.json.gz")
    for one, twin, extended in zip(stock["episodes"], oracle["episodes"], ansr["episodes"], strict=True):
        assert one["instruction"]["instruction_text"] != twin["instruction"]["instruction_text"]
        assert {k: v for k, v in one.items() if k != "instruction"} == {
            k: v for k, v in twin.items() if k != "instruction"
        }
        assert one == {k: v for k, v in extended.items() if k != "subgoals"}
        assert [s["position"] for s in extended["subgoals"]] == one["info"]["subgoals"]
    assert stock["instruction_vocab"] == oracle["instruction_vocab"] == ansr["instruction_vocab"]
    truths = [
        (exported / variant / split / f"{split}_gt.json.gz").read_bytes() for variant in ("vlnce", "ansr", "oracle")
    ]
    assert truths[0] == truths[1] == truths[2]


@pytest.mark.parametrize("split", SPLITS)
def test_the_manifest_knows_every_leaf(exported: Path, split: str, tables: MemoryTables) -> None:
    stock = {e.episode_id: e for e in load_split(exported / "vlnce" / split / f"{split}.json.gz")}
    pool = {row["episode_id"]: row for row in rows_of(tables.tables["replicacad"]["episodes"])}
    lines = manifest_of(exported, split)
    assert [str(line["episode_id"]) for line in lines] == list(stock)
    for line in lines:
        row = ManifestEpisode.model_validate(line)
        assert row.program.gold_leaf() == row.gold_leaf
        assert row.leaves[row.gold_leaf].goals == tuple(tuple(g.position) for g in stock[str(row.episode_id)].goals)
        assert line["leaves"] == pool[row.episode_id]["leaves"]
        assert row.split == split
        assert row.snapshot == "made"


def test_nothing_in_the_files_tells_the_gold_leaf_to_an_agent(exported: Path) -> None:
    episode = read(exported / "vlnce" / "train" / "train.json.gz")["episodes"][0]
    assert not {"gold_leaf", "program", "conditions", "leaves"} & set(episode["info"])


def test_one_vocabulary_knows_every_word_of_all_splits(exported: Path) -> None:
    words = set(read(exported / "vlnce" / "test" / "test.json.gz")["instruction_vocab"]["word_list"])
    for variant in ("vlnce", "oracle"):
        for split in SPLITS:
            for episode in load_split(exported / variant / split / f"{split}.json.gz"):
                assert words.issuperset(tokenize(episode.instruction.instruction_text))
                assert 1 not in episode.instruction.instruction_tokens


def test_same_snapshot_same_bytes(exported: Path, tables: MemoryTables, tmp_path: Path) -> None:
    export_snapshot(tables, tmp_path, oracle_text=linear_text)
    assert hashes(tmp_path) == hashes(exported)
    # gzip: no time, no file name
    head = (tmp_path / "vlnce" / "train" / "train.json.gz").read_bytes()[:10]
    assert head[3] == 0
    assert head[4:8] == bytes(4)


def test_bytes_do_not_depend_on_how_the_rows_are_cut(exported: Path, tables: MemoryTables, tmp_path: Path) -> None:
    class Sliced(MemoryTables):
        def batches(self, table: str, source: str, columns: Any = None) -> Any:
            for batch in MemoryTables.batches(self, table, source, columns):
                yield from (batch.slice(i, 7) for i in range(0, batch.num_rows, 7))

    export_snapshot(Sliced(tables.id, tables.tables), tmp_path, oracle_text=linear_text)
    assert hashes(tmp_path) == hashes(exported)


def test_a_folder_of_parts_exports_as_the_tables_do(exported: Path, tables: MemoryTables, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    snapshot = tmp_path / "made"
    for source, named in tables.tables.items():
        for name, table in named.items():
            folder = snapshot / name / f"source={source}"
            folder.mkdir(parents=True)
            scenes = sorted(set(table.column("scene_id").to_pylist()))
            # Parts in an order that is not that of their names.
            for number, scene in enumerate(reversed(scenes)):
                mine = [value == scene for value in table.column("scene_id").to_pylist()]
                pq.write_table(table.filter(mine), folder / f"part-{number:05d}.parquet")
    found = FolderTables(snapshot)
    assert found.id == "made"
    assert found.sources == ("replicacad",)
    export_snapshot(found, tmp_path / "out", oracle_text=linear_text)
    assert hashes(tmp_path / "out") == hashes(exported)
    part = next((snapshot / "scenes" / "source=replicacad").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(FormatError, match="part-"):
        export_snapshot(found, tmp_path / "out")
    for path in (snapshot / "instructions" / "source=replicacad").glob("*.parquet"):
        path.unlink()
    with pytest.raises(MissingFileError, match="instructions"):
        list(found.batches("instructions", "replicacad"))


def test_the_index_lists_every_file_with_its_hash(exported: Path) -> None:
    index = json.loads((exported / "export.json").read_text())
    assert {path: entry["sha256"] for path, entry in index["files"].items()} == {
        path: digest for path, digest in hashes(exported).items() if path != "export.json"
    }
    assert all((exported / path).stat().st_size == entry["bytes"] for path, entry in index["files"].items())
    for split, count in index["episodes"].items():
        assert len(manifest_of(exported, split)) == count
    assert sum(index["episodes"].values()) + sum(index["left_out"].values()) == 12 * 6 * 4


def test_ids_and_rows_are_stable_when_scenes_are_added(exported: Path, tmp_path: Path) -> None:
    more = made_snapshot(
        {"replicacad": ["apt_0", "apt_1", *(f"v3_sc{i}_staging_00" for i in (0, 1)), "v3_sc0_staging_01"]}
    )
    export_snapshot(more, tmp_path)
    before = {line["episode_id"]: line for split in SPLITS for line in manifest_of(exported, split)}
    after = {line["episode_id"]: line for split in SPLITS for line in manifest_of(tmp_path, split)}
    shared = set(before) & set(after)
    assert shared
    assert all(before[name] == after[name] for name in shared)


def test_files_of_a_former_export_do_not_linger(tables: MemoryTables, tmp_path: Path) -> None:
    export_snapshot(tables, tmp_path, oracle_text=linear_text)
    (tmp_path / "notes.txt").write_text("mine")
    export_snapshot(tables, tmp_path)
    left = hashes(tmp_path)
    assert "notes.txt" in left
    assert not any(path.startswith("oracle/") for path in left)
    index = json.loads((tmp_path / "export.json").read_text())
    index["files"]["../outside"] = {}
    outside = tmp_path.parent / "outside"
    outside.write_text("not ours")
    (tmp_path / "export.json").write_text(json.dumps(index))
    export_snapshot(tables, tmp_path)
    assert outside.read_text() == "not ours"


def test_an_empty_snapshot_is_one_clear_error(tmp_path: Path) -> None:
    empty = MemoryTables(
        "empty",
        {
            "gibson": {
                "episodes": EPISODES.empty_table(),
                "instructions": INSTRUCTIONS.empty_table(),
                "scenes": SCENES.empty_table(),
            }
        },
    )
    with pytest.raises(StoreError, match="holds no episodes"):
        export_snapshot(empty, tmp_path)
    with pytest.raises(StoreError, match="holds no episodes"):
        export_snapshot(MemoryTables("none", {}), tmp_path)
    assert list(tmp_path.iterdir()) == []


def changed(tables: MemoryTables, table: str, change: Any) -> MemoryTables:
    import pyarrow as pa

    named = dict(tables.tables["replicacad"])
    rows = named[table].to_pylist()
    change(rows)
    named[table] = pa.Table.from_pylist(rows, named[table].schema)
    return MemoryTables(tables.id, {"replicacad": named})


def test_episodes_that_can_not_be_published_are_counted(tables: MemoryTables, tmp_path: Path) -> None:
    def spoil(rows: list[dict[str, Any]]) -> None:
        rows[0].update(ground_truth_steps=251, max_steps=502)
        rows[4].update(ground_truth_steps=250, max_steps=501)
        rows[1]["ground_truth_steps"] = rows[1]["max_steps"] + 1
        rows[3].update({key: rows[2][key] for key in ("instruction_text", "start_position")})

    report = export_snapshot(changed(tables, "episodes", spoil), tmp_path)
    assert report.left_out["over the step budget"] == 2
    assert report.left_out["same text from the same start as another"] == 1
    published = {line["episode_id"] for split in SPLITS for line in manifest_of(tmp_path, split)}
    ids = tables.tables["replicacad"]["episodes"].column("episode_id").to_pylist()
    assert not published & {ids[0], ids[1], ids[3]}
    assert report.most_steps in (300, 501), "a proportional budget may be more than 500"


def test_texts_that_would_be_cut_are_left_out_with_their_groups(tables: MemoryTables, tmp_path: Path) -> None:
    rows = tables.tables["replicacad"]["episodes"].to_pylist()
    single = next(row["episode_id"] for row in rows if row["group_id"] is None)
    exact = next(row["episode_id"] for row in rows if row["group_id"] is None and row["episode_id"] != single)
    member = next(row for row in rows if row["group_id"] is not None)
    group = {row["episode_id"] for row in rows if row["group_id"] == member["group_id"]}
    assert len(group) > 1
    words = {single: 201, member["episode_id"]: 230, exact: 200}

    def lengthen(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            if row["episode_id"] in words:
                row["instruction_text"] = " ".join(["sofa"] * words[row["episode_id"]])

    long = changed(tables, "episodes", lengthen)
    report = export_snapshot(long, tmp_path / "limited")
    assert report.left_out["more tokens than an agent reads"] == 2
    assert report.left_out["its counterfactual group is not whole"] == len(group) - 1
    assert report.texts_cut == 0
    published = {line["episode_id"] for split in SPLITS for line in manifest_of(tmp_path / "limited", split)}
    assert not published & {single, *group}
    assert "2 more tokens than an agent reads" in (tmp_path / "limited" / "README.md").read_text()
    # Without a limit there is no such reason, and what is published of them is cut.
    for none in 0, None:
        out = tmp_path / f"unlimited-{none}"
        report = export_snapshot(long, out, SplitsConfig(max_tokens=none))
        assert "more tokens than an agent reads" not in report.left_out
        published = {line["episode_id"] for split in SPLITS for line in manifest_of(out, split)}
        assert report.texts_cut == len(published & {single, member["episode_id"]}) > 0
    # The limit is inclusive, and its own.
    report = export_snapshot(long, tmp_path / "wider", SplitsConfig(max_tokens=201))
    assert report.left_out["more tokens than an agent reads"] == 1


def test_of_a_building_annotated_twice_the_verified_one_is_published(tmp_path: Path) -> None:
    """Both are of one mesh; the official list knows a building by its name alone."""
    buildings = ["automated/Allensville", "automated/Beechwood", "verified/Allensville", "verified/Darden"]
    report = export_snapshot(made_snapshot({"gibson": buildings}), tmp_path)
    assert report.left_out["its building is there by its verified annotation"] == 72
    published = {scene for found in report.scenes.values() for scene in found}
    assert published == {"gibson/automated/Beechwood", "gibson/verified/Allensville", "gibson/verified/Darden"}
    assert {f"gibson/{name}" for name in ("verified/Allensville", "automated/Beechwood")} <= {*report.scenes["train"]}
    assert report.scenes["val_unseen"] == ["gibson/verified/Darden"]
    episodes = [e for split in SPLITS for e in read(tmp_path / "vlnce" / split / f"{split}.json.gz")["episodes"]]
    assert {e["scene_id"] for e in episodes} == {
        f"gibson/{name}/{name}.glb" for name in ("Allensville", "Beechwood", "Darden")
    }


def test_built_navmeshes_are_shipped_and_scenes_without_one_left_out(tables: MemoryTables, tmp_path: Path) -> None:
    data = b"navmesh"

    def build(rows: list[dict[str, Any]]) -> None:
        rows[0]["navmesh_path"] = None
        for row in rows[1:]:
            row["navmesh_built"] = True
            row["navmesh_sha256"] = hashlib.sha256(data).hexdigest()

    built = changed(tables, "scenes", build)
    lost = "v3_sc0_staging_01"
    report = export_snapshot(built, tmp_path, navmeshes=lambda source, row: None if row["scene_id"] == lost else data)
    assert report.left_out["its scene has no navmesh"] == 72
    assert report.left_out["the navmesh built for its scene is missing or changed"] == 72
    lines = [line for split in SPLITS for line in manifest_of(tmp_path, split)]
    assert lines
    for line in lines:
        assert line["scene_id"] not in ("apt_0", lost)
        assert (tmp_path / line["navmesh"]).read_bytes() == data


def test_a_full_disk_leaves_no_file_under_a_final_name(
    tables: MemoryTables, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = 0
    real = streams.ByteStream._put

    def limited(self: streams.ByteStream, data: bytes) -> None:
        nonlocal written
        written += len(data)
        if written > 200_000:
            with streams._refusals(self.path):
                raise OSError(errno.ENOSPC, "No space left on device")
        real(self, data)

    monkeypatch.setattr(streams.ByteStream, "_put", limited)
    with pytest.raises(StoreError, match="No space left on device"):
        export_snapshot(tables, tmp_path, oracle_text=linear_text)
    monkeypatch.undo()
    for path in tmp_path.rglob("*"):
        if path.is_file():
            assert not path.name.startswith(".")
            if path.suffix == ".gz":
                read(path)
    assert not (tmp_path / "export.json").exists()


def test_an_export_folder_that_is_a_file_is_one_clear_error(tables: MemoryTables, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(StoreError, match="the export folder is a file"):
        export_snapshot(tables, tmp_path / "out")


def test_a_missing_instruction_and_scenes_out_of_order_are_refused(tables: MemoryTables, tmp_path: Path) -> None:
    without = changed(tables, "instructions", lambda rows: rows.pop(0))
    with pytest.raises(StoreError, match="is missing"):
        export_snapshot(without, tmp_path)
    with pytest.raises(StoreError, match="comes after"):
        export_snapshot(changed(tables, "episodes", lambda rows: rows.reverse()), tmp_path)
    with pytest.raises(StoreError, match="occur twice"):
        export_snapshot(changed(tables, "episodes", lambda rows: rows.append(rows[-1])), tmp_path)


def test_any_character_goes_through(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pairs = [made_rows(rng, "apt_0", number, "simple") for number in range(40)]
    for episode, _ in pairs:
        episode["instruction_text"] = "Gehe zu “Öfen” 椅子 \x07 \U0001f6cb, " + str(episode["episode_id"])
    import pyarrow as pa

    odd = MemoryTables(
        "odd",
        {
            "replicacad": {
                "episodes": pa.Table.from_pylist([e for e, _ in pairs], EPISODES),
                "instructions": pa.Table.from_pylist([i for _, i in pairs], INSTRUCTIONS),
                "scenes": pa.Table.from_pylist([made_scene("apt_0")], SCENES),
            }
        },
    )
    report = export_snapshot(odd, tmp_path, SplitsConfig())
    loaded = load_split(tmp_path / "vlnce" / "test" / "test.json.gz")
    assert len(loaded) == report.episodes["test"] > 0
    assert loaded[0].instruction.instruction_text.startswith("Gehe zu “Öfen” 椅子 \x07 \U0001f6cb, ")

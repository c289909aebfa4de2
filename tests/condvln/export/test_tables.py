"""Rows of a table that stands in several files come scene by scene, as from one file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.export import tables
from condvln.export.tables import FolderTables
from schemas.errors import FormatError

PART = "part-{:05d}.parquet"


def written(folder: Path, rows: Sequence[tuple[str, int, int]]) -> list[tuple[str, int]]:
    """Write rows (scene, its number, part of the scene) as the factory publishes them: each part by scene. Return all
    of them by scene.
    """
    place = folder / "objects" / "source=made"
    place.mkdir(parents=True)
    for part in {part for _, _, part in rows}:
        own = sorted((scene, number) for scene, number, its_part in rows if its_part == part)
        table = pa.table({"number": [n for _, n in own], "scene_id": [s for s, _ in own]})
        pq.write_table(table, place / PART.format(part))
    return sorted((scene, number) for scene, number, _ in rows)


def read(folder: Path, columns: Sequence[str] | None) -> list[tuple[int, ...]]:
    batches = [*FolderTables(folder).batches("objects", "made", columns)]
    assert all(batch.schema.names == [*(columns or ("number", "scene_id"))] for batch in batches)
    return [tuple(row.values()) for batch in batches for row in batch.to_pylist()]


@given(
    scenes=st.dictionaries(
        st.text("ab19-", min_size=1, max_size=4), st.tuples(st.integers(0, 3), st.integers(1, 9)), min_size=1
    )
)
def test_scenes_ascend_whatever_file_each_is_in(scenes: dict[str, tuple[int, int]]) -> None:
    rows = [(scene, number, part) for scene, (part, count) in scenes.items() for number in range(count)]
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as name:
        patch.setattr(tables, "BATCH_ROWS", 4)  # scenes end within batches, and go on in the next
        expected = written(Path(name), rows)
        assert read(Path(name), None) == [(number, scene) for scene, number in expected]
        assert read(Path(name), ("scene_id", "number")) == expected
        assert read(Path(name), ("number",)) == [(number,) for _, number in expected]


def test_a_damaged_file_among_several_is_named(tmp_path: Path) -> None:
    written(tmp_path, [("a", number, part) for part in range(2) for number in range(3)])
    file = tmp_path / "objects" / "source=made" / PART.format(1)
    file.write_bytes(file.read_bytes()[:4] + b"\xff" * 40 + file.read_bytes()[44:])
    with pytest.raises(FormatError, match=r"part-\*\.parquet file is damaged|not a Parquet file"):
        read(tmp_path, None)


def test_files_that_name_scenes_differently_are_damaged(tmp_path: Path) -> None:
    written(tmp_path, [("a", 1, 0), ("b", 2, 1)])
    file = tmp_path / "objects" / "source=made" / PART.format(1)
    pq.write_table(pa.table({"number": [1], "scene_id": [7]}), file)
    with pytest.raises(FormatError, match="damaged"):
        read(tmp_path, None)

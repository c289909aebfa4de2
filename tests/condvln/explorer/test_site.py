"""The folder of the page: complete, stable, and refused where it would overwrite something else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from condvln.explorer import Site, episode_document
from condvln.explorer.site import EPISODES_A_CHUNK, NAMED, PARTS
from schemas.errors import UsageError
from tests.condvln.explorer.made_rows import made_manifest, no_rooms
from tests.site_chunks import chunk_content


def write(out: Path, rows: list[dict[str, Any]]) -> Path:
    site = Site(out)
    site.add_scene("replicacad", "apt_0", rows, map(episode_document, rows), plan=no_rooms())
    return site.finish("made")


def chunks(out: Path) -> dict[str, Any]:
    return dict(chunk_content(path.read_bytes()) for path in sorted((out / "data").glob("*.js")))


def test_every_episode_is_found_by_the_index(tmp_path: Path) -> None:
    rows = made_manifest(40)
    write(tmp_path / "page", rows)
    found = chunks(tmp_path / "page")
    index = found["index"]
    assert index["columns"]["id"] == [str(row["episode_id"]) for row in rows]
    assert index["chunks"] == [*range(0, len(rows), EPISODES_A_CHUNK)]
    episodes = [one for k in range(len(index["chunks"])) for one in found[f"episodes-{k}"]]
    assert [one["id"] for one in episodes] == index["columns"]["id"]
    assert found["texts-0"] == [row["instruction_text"] for row in rows]
    for name in NAMED:
        shown = [index["names"][name][number] for number in index["columns"][name]]
        if name != "observability":
            assert shown == [row[name] for row in rows]
    for k, row in enumerate(rows):
        leaf = row["program"]["leaves"][row["gold_leaf"]]
        assert index["names"]["label"][index["columns"]["gold_label"][k]] == leaf["moves"][-1]["label"]
    groups = {row["group_id"] for row in rows} - {None}
    assert index["groups"] == len(groups)
    assert set(index["columns"]["group"]) == {-1, *range(len(groups))}


def test_equal_inputs_give_equal_bytes(tmp_path: Path) -> None:
    rows = made_manifest(4)
    for name in ("a", "b"):
        write(tmp_path / name, rows)
    files = [sorted((tmp_path / name).rglob("*.*")) for name in ("a", "b")]
    assert [path.read_bytes() for path in files[0]] == [path.read_bytes() for path in files[1]]


def test_a_former_page_is_replaced_whole(tmp_path: Path) -> None:
    write(tmp_path, made_manifest(40))
    write(tmp_path, made_manifest(2))
    assert {path.name for path in tmp_path.iterdir()} == {"data", "index.html", *PARTS} - {"page.html"}
    assert "episodes-1" not in chunks(tmp_path)


@pytest.mark.parametrize("name", ["index.html", "notes.txt", "data/table.parquet", "data/index.json"])
def test_a_folder_with_other_files_is_left_alone(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(UsageError, match="holds files that condvln explore did not write"):
        Site(tmp_path)
    assert [path.read_text() for path in tmp_path.rglob("*") if path.is_file()] == ["mine"]


def test_a_page_that_was_half_written_is_written_again(tmp_path: Path) -> None:
    write(tmp_path, made_manifest(2))
    Site(tmp_path)  # begins, and is cut off
    for name in (".index.html.part", "data/.scene-1.js.part"):  # what a killed writer leaves
        (tmp_path / name).write_text("half")
    assert not (tmp_path / "index.html").exists()
    assert write(tmp_path, made_manifest(2)).is_file()
    assert not [*tmp_path.rglob("*.part")]


def test_the_page_names_its_scripts_and_nothing_from_elsewhere(tmp_path: Path) -> None:
    write(tmp_path, made_manifest(1))
    page = (tmp_path / "index.html").read_text()
    assert set(re.findall(r'<script src="([^"]+)"', page)) == {name for name in PARTS if name.endswith(".js")}
    assert "default-src 'none'" in page
    for name in PARTS:
        text = (tmp_path / ("index.html" if name == "page.html" else name)).read_text()
        addresses = re.findall(r"(?:https?:)?//[\w.]+\.\w+", text)
        assert addresses in ([], ["http://www.w3.org"]), name
        assert not re.search(
            r"\binnerHTML\b|\bouterHTML\b|insertAdjacentHTML|document\.write|\beval\b|new Function", text
        )
        assert not re.search(r"\bfetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon", text), name

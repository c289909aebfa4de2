"""``condvln show``: an export tells of an episode what the configuration's snapshot tells; samples are spread."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.samples import make_samples
from jobs.generate import run_generate
from jobs.report import Report
from jobs.show import show_episodes, show_export, spread
from jobs.workspace import published
from schemas.config import Config, SourceConfig
from schemas.errors import FormatError, MissingFileError, UsageError
from schemas.program import CATEGORIES
from tests.jobs.conftest import configuration, remove
from tests.once import made_once

KEYS = st.tuples(st.sampled_from(CATEGORIES), st.sampled_from(("gibson", "ithor", "procthor")))


@given(st.dictionaries(KEYS, st.integers(0, 5)), st.integers(1, 20))
def test_samples_go_round_the_categories_and_their_sources(held: dict[tuple[str, str], int], sample: int) -> None:
    items = {key: [(*key, k) for k in range(count)] for key, count in held.items()}
    picked = spread(items, sample)
    assert len(picked) == len(set(picked)) == min(sample, sum(held.values()))

    def taken(category: str, source: str | None = None) -> int:
        return sum(c == category and source in (None, s) for c, s, _ in picked)

    for category in CATEGORIES:
        held_here = sum(count for (c, _), count in held.items() if c == category)
        # Whoever has fewer than another has no more to give.
        for other in CATEGORIES:
            assert taken(category) + 1 >= taken(other) or taken(category) == held_here
        counts = {s: (taken(category, s), count) for (c, s), count in held.items() if c == category}
        for shown, count in counts.values():
            assert shown == count or all(shown + 1 >= others for others, _ in counts.values())


@pytest.mark.parametrize("sources", [("gibson",), ("gibson", "mp3d"), ("gibson", "mp3d", "procthor", "replicacad")])
def test_a_small_sample_is_of_every_source(sources: tuple[str, ...]) -> None:
    items = {(category, source): [f"{category} {source}"] for category in CATEGORIES for source in sources}
    shown = spread(items, len(CATEGORIES))
    assert {one.split()[1] for one in shown} == set(sources)


def test_an_export_tells_what_the_snapshot_tells(made_run: tuple[Config, Report], export: Path) -> None:
    config, _ = made_run
    counts = json.loads((export / "export.json").read_text())["episodes"]
    found = show_export(export, sample=1000)
    shown = found.document["episodes"]
    assert len(shown) == sum(counts.values()) > 2
    for entry in shown:
        one = show_export(export, episode=str(entry["episode_id"]))
        published = show_episodes(config, episode=str(entry["episode_id"]))
        assert one.lines == published.lines
        for part in (entry["episode_hash"], entry["episode_hash"][:12]):
            assert show_export(export, episode=part).lines == one.lines
            assert show_episodes(config, episode=part).lines == one.lines
        assert one.document["episodes"] == [entry]
        assert one.document["episodes"][0]["tree"] == published.document["episodes"][0]["tree"]
    first = show_export(export, sample=2).document["episodes"]
    # So few nested episodes may have no even share of gold leaves, and then the export has none.
    there = [category for category in CATEGORIES if category in {row["category"] for row in shown}]
    assert [row["category"] for row in first] == (there[:2] if len(there) > 1 else 2 * there)


@pytest.fixture(scope="module")
def half_placed(made_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Config:
    """A run over apartments with navmeshes and over scans without."""

    def make(folder: Path) -> Config:
        make_samples(folder / "scans", family="gibson", scenes=1, seed=3)
        remove(folder / "scans", "*.glb", "*.navmesh")
        scans = SourceConfig(family="gibson", root=folder / "scans")
        apartments = SourceConfig(family="replicacad", root=made_dataset)
        config = configuration(folder, made_dataset, sources=(apartments, scans))
        assert run_generate(config, inline=True).exit_code == 0
        return config

    return made_once(tmp_path_factory, "half placed", make)


def test_where_no_navmesh_is_instructions_stand_for_episodes(half_placed: Config, tmp_path: Path) -> None:
    found = show_episodes(half_placed, sample=4, picture=tmp_path)
    entries = found.document["episodes"]
    assert [(e["category"], e["source"], e["episode_id"] is None) for e in entries] == [
        ("simple", "gibson", True),
        ("nested", "replicacad", False),
        ("simple", "replicacad", False),
        ("nested", "gibson", True),
    ]
    # What has an episode is drawn, and nothing else.
    assert {path.stem for path in tmp_path.iterdir()} == {str(entry["episode_id"]) for entry in entries[1:3]}
    instructions = {row["instruction_id"]: row for row in published(half_placed).table("instructions").to_pylist()}
    for entry in entries:
        row = instructions[entry["instruction_id"]]
        truths = [condition["truth"] for condition in entry["program"]["conditions"]]
        assert truths == [condition["truth"] for condition in row["conditions"]]
        assert entry["instruction_text"].endswith(row["text"])
        assert ("no_episode" in entry) == (entry["episode_id"] is None)
    lines = "\n".join(found.lines)
    assert lines.count("no episode: no navmesh") == 2
    assert all(
        f"“{entry['instruction_text']}”" in lines and entry["tree"].splitlines()[0] in lines for entry in entries
    )


def test_an_instruction_is_shown_by_its_id(half_placed: Config) -> None:
    unplaced, _, placed, _ = show_episodes(half_placed, sample=4).document["episodes"]
    for entry in unplaced, placed:
        one = show_episodes(half_placed, episode=entry["instruction_id"])
        assert entry in one.document["episodes"]
        assert {e["instruction_id"] for e in one.document["episodes"]} == {entry["instruction_id"]}
    assert show_episodes(half_placed, episode=str(placed["episode_id"])).document["episodes"] == [placed]
    with pytest.raises(UsageError, match="no episode and no instruction 'nowhere'"):
        show_episodes(half_placed, episode="nowhere")


def test_pictures_need_the_navmesh_alone(export: Path, made_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="--data DIR"):
        show_export(export, picture=tmp_path)
    name = show_export(export, picture=tmp_path, roots=(made_dataset,)).document["episodes"][0]["episode_id"]
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_no_export_is_said(export: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="neither a configuration nor an export"):
        show_export(tmp_path)
    with pytest.raises(UsageError, match="no episode 'nowhere'"):
        show_export(export, episode="nowhere")
    (tmp_path / "manifest").mkdir()
    manifest = tmp_path / "manifest" / "train.jsonl"
    old = '{"category": "simple", "source": "made", "episode_id": "1"}'
    for line, says in (
        (old, "episode_id: .*Export the split again"),
        ('{"category": 1}', "not a manifest row"),
        ("[]", "not a JSON object"),
        ("{", "line 1"),
    ):
        manifest.write_text(line + "\n")
        with pytest.raises(FormatError, match=says):
            show_export(tmp_path)
    manifest.write_text('{"category": "simple", "source": "made", "episode_id": 1, "episode_hash": "a"}\n')
    with pytest.raises(FormatError, match="line 1: instruction_id"):
        show_export(tmp_path)
    manifest.write_text("")
    with pytest.raises(UsageError, match="no episodes"):
        show_export(tmp_path)

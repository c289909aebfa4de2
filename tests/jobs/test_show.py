"""``condvln show``: an export tells of an episode what the configuration's snapshot tells; samples are spread."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jobs.report import Report
from jobs.show import show_episodes, spread
from jobs.show_export import show_export
from schemas.config import Config
from schemas.errors import FormatError, MissingFileError, UsageError
from schemas.program import CATEGORIES

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


def test_an_export_tells_what_the_snapshot_tells(made_run: tuple[Config, Report], export: Path) -> None:
    config, _ = made_run
    counts = json.loads((export / "export.json").read_text())["episodes"]
    found = show_export(export, sample=1000)
    shown = found.document["episodes"]
    assert len(shown) == sum(counts.values()) > 2
    for entry in shown:
        one = show_export(export, episode=entry["episode_id"])
        published = show_episodes(config, episode=entry["episode_id"])
        assert one.lines == published.lines
        assert one.document["episodes"] == [entry]
        assert one.document["episodes"][0]["tree"] == published.document["episodes"][0]["tree"]
    first = show_export(export, sample=2).document["episodes"]
    assert [row["category"] for row in first] == ["simple", "nested"]


def test_pictures_need_the_navmesh_alone(export: Path, made_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="--navmesh-root"):
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
    for line, says in ('{"category": 1}', "not a manifest row"), ("[]", "not a manifest row"), ("{", "line 1"):
        manifest.write_text(line + "\n")
        with pytest.raises(FormatError, match=says):
            show_export(tmp_path)
    manifest.write_text('{"category": "simple", "source": "made", "episode_id": "a"}\n')
    with pytest.raises(FormatError, match="line 1: instruction_id"):
        show_export(tmp_path)
    manifest.write_text("")
    with pytest.raises(UsageError, match="no episodes"):
        show_export(tmp_path)

"""Read a split of R2R_VLNCE or another stock file without a manifest, to summarise other evaluators' results.

Such a file has no branches, so only the measures in the results are summarised, by scene. Paths are not scored, since
that needs the navmesh named by an export's manifest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from condvln.evaluation.evaluate import AXES
from condvln.evaluation.measures import NO_LEAF
from condvln.formats.json_entries import document
from schemas.errors import FormatError

__all__ = ["StockEpisode", "stock_episodes", "stock_file"]

_SHAPES: Final = ("{split}.json.gz", "{split}/{split}.json.gz", "vlnce/{split}/{split}.json.gz")


@dataclass(frozen=True)
class StockEpisode:
    """One episode of a file in the format of R2R_VLNCE, without a manifest."""

    episode_id: str
    axes: Mapping[str, str | int | None]
    aliases: tuple[str, ...] = ()
    group_id: str | None = None
    gold_leaf: int = NO_LEAF
    n_leaves: int = 0
    subgoals: int = field(default=0)


def stock_file(folder: Path, split: str) -> Path | None:
    """Return the split's file in a folder with R2R_VLNCE's layout; None if there is none."""
    paths = (folder / shape.format(split=split) for shape in _SHAPES)
    return next((path for path in paths if path.is_file()), None)


def stock_episodes(path: Path) -> list[StockEpisode]:
    """Read the episodes of a stock VLN-CE, ANSR-v1 or RxR file.

    Raises
    ------
    FormatError : the file has another format, or an id occurs twice
    """
    content = document(path)
    episodes = content.get("episodes") if isinstance(content, dict) else None
    if not isinstance(episodes, list):
        raise FormatError(
            "the file has no list of episodes", where=path, remedy="Check the file with condvln export --validate"
        )
    found: dict[str, StockEpisode] = {}
    for number, episode in enumerate(episodes):
        name, scene = (episode.get(key) if isinstance(episode, dict) else None for key in ("episode_id", "scene_id"))
        if isinstance(name, bool) or not isinstance(name, str | int) or not isinstance(scene, str):
            raise FormatError(
                "an episode lacks its id or its scene",
                where=path,
                place=f"episodes.{number}",
                remedy="Check the file with condvln export --validate",
            )
        if str(name) in found:
            raise FormatError(
                "the id occurs twice",
                where=path,
                place=f"episode {name}",
                remedy="Check the file with condvln export --validate",
            )
        stops = episode.get("subgoals")
        axes = dict.fromkeys(AXES) | {"source": scene.split("/")[0], "scene": scene}
        found[str(name)] = StockEpisode(str(name), axes, subgoals=len(stops) if isinstance(stops, list) else 0)
    return list(found.values())

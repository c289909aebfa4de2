"""The reference agent ``looker`` for ``condvln walk``: its configuration, and the datasets that it sees."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from condvln.evaluation.looker import LookingAgent
from condvln.evaluation.scene_views import SceneViews
from condvln.evaluation.split import split_tasks
from condvln.navigation.navmesh_folder import NavmeshFolder
from jobs.assignments import read_section
from schemas.config import LookerConfig
from schemas.errors import UsageError

__all__ = ["LOOKER", "datasets_of", "looker_picks", "looking_agent"]

LOOKER: Final = "looker"
"""Name of the agent, beside those of `condvln.evaluation.agents.AGENTS`."""


def looking_agent(datasets: Sequence[str], keys: Sequence[str]) -> LookingAgent:
    """Create the agent ``looker``, which sees the scenes of the given datasets.

    Parameters
    ----------
    datasets : ``FAMILY=FOLDER`` each
    keys : ``noise.missed=0.1`` and the like, keys of `LookerConfig`

    Raises
    ------
    UsageError : a dataset or key is not of that form, an unknown key, or a value that is not allowed
    """
    roots = datasets_of(datasets)
    if not roots:
        raise UsageError(
            f"{LOOKER} sees nothing, since no dataset was named", place="--scenes", remedy="Add --scenes FAMILY=FOLDER."
        )
    config = read_section(LookerConfig, keys, option="--looker", example="noise.missed=0.1")
    return LookingAgent(SceneViews(roots), config)


def datasets_of(texts: Sequence[str]) -> dict[str, Path]:
    """Parse texts ``FAMILY=FOLDER``; return the folders by family.

    Raises
    ------
    UsageError : a text is not of the form ``FAMILY=FOLDER``
    """
    found = {}
    for text in texts:
        family, equals, folder = text.partition("=")
        if not (family and equals and folder):
            raise UsageError(f"{text!r} is not FAMILY=FOLDER", place="--scenes", remedy="Example: procthor=data/houses")
        found[family] = Path(folder)
    return found


def looker_picks(
    export: Path, split: str, datasets: Sequence[str], keys: Sequence[str], roots: Sequence[Path], seed: int
) -> dict[str, int]:
    """Return, by episode id, the index of the leaf that the agent ``looker`` picks in each episode of a split."""
    agent = looking_agent(datasets, keys)
    navmeshes = NavmeshFolder((export, *roots, *datasets_of(datasets).values()))
    return {task.episode_id: agent.walk(task, navmeshes(task), seed).leaf for task in split_tasks(export, split)}

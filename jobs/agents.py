"""Agents for ``condvln walk`` beside the reference agents: ``looker`` with the datasets that it sees, and users' own
agents by name; and ``condvln serve``, which offers a split to agents as an OpenEnv server.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, cast

from condvln.evaluation.justified import EvidenceSeen
from condvln.evaluation.looker import LookingAgent
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.scene_views import SceneViews
from condvln.evaluation.split import split_tasks
from condvln.evaluation.task import Task
from condvln.evaluation.walker import Eyes, Policy, SeenObject, labels_in_view, walk
from condvln.export.tables import rows_of
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.sources.registry import open_source
from jobs.export_origin import config_of
from jobs.settings import read_section
from jobs.workspace import published
from schemas.config import Config, Family, LookerConfig
from schemas.errors import UsageError

__all__ = [
    "LOOKER",
    "datasets_of",
    "evidence_seen",
    "eyes_of",
    "folders_of",
    "is_policy",
    "looker_picks",
    "looking_agent",
    "policy_named",
    "serve_split",
    "walk_policy",
]

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
            f"{LOOKER} sees nothing, since no dataset was named", place="--data", remedy="Add --data FAMILY=DIR."
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
            raise UsageError(f"{text!r} is not FAMILY=DIR", place="--data", remedy="Example: procthor=data/houses")
        found[family] = Path(folder)
    return found


def folders_of(texts: Sequence[str]) -> tuple[list[str], list[Path]]:
    """Return, of texts ``[FAMILY=]DIR``, those that name a family, and the folders of all."""
    return [text for text in texts if "=" in text], [Path(text.partition("=")[2] or text) for text in texts]


def evidence_seen(export: Path, datasets: Sequence[str], roots: Sequence[Path]) -> EvidenceSeen:
    """Return what is recognised on walks in the scenes of the given datasets, ``FAMILY=FOLDER`` each, by the rules that
    the export was made with; the default rules if it does not say.

    Raises
    ------
    UsageError : a dataset is not of that form
    """
    folders = datasets_of(datasets)
    config = config_of(export, folders)
    return EvidenceSeen(
        {family: open_source(cast(Family, family), folder) for family, folder in folders.items()},
        NavmeshFolder((export, *roots, *folders.values())),
        config.places,
        config.episodes,
        config.agent,
    )


def looker_picks(export: Path, split: str, datasets: Sequence[str], keys: Sequence[str], seed: int) -> dict[str, int]:
    """Return, by episode id, the index of the leaf that the agent ``looker`` picks in each episode of a split."""
    agent = looking_agent(datasets, keys)
    navmeshes = NavmeshFolder((export, *datasets_of(datasets).values()))
    return {task.episode_id: agent.walk(task, navmeshes(task), seed).leaf for task in split_tasks(export, split)}


_COLUMNS = ["scene_id", "label", "center"]


def is_policy(agent: str) -> bool:
    """Whether `agent` is the name of a user's agent (``module:Class``), and not of a reference agent."""
    return ":" in agent


def policy_named(name: str) -> Policy:
    """Create the agent ``module:Class``; modules in the current folder are found too.

    Raises
    ------
    UsageError : there is no such module or class, or it makes something that neither begins nor acts
    """
    module, _, factory = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        found = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(
            f"no agent {name!r} ({error})", remedy="Give module:Class; Python must find the module from this folder."
        ) from error
    policy = found() if callable(found) else found
    lacking = [method for method in ("begin", "act") if not callable(getattr(policy, method, None))]
    if lacking:
        raise UsageError(
            f"{name} has no {lacking[0]}()", remedy="An agent needs begin(observation) and act(observation)."
        )
    return cast(Policy, policy)


def eyes_of(config: Config, pathfinder_of: Callable[[Task], Pathfinder]) -> Eyes:
    """Return the function that tells an agent which objects of the published snapshot are in view.

    Raises
    ------
    StoreError : nothing is published
    """
    table = published(config).table("objects", [*_COLUMNS])
    seen: dict[str, list[SeenObject]] = {}
    for row, source in zip(rows_of(table.select(_COLUMNS)), table.column("source").to_pylist(), strict=True):
        x, y, z = row["center"]
        seen.setdefault(f"{source}/{row['scene_id']}", []).append(SeenObject(row["label"], (x, y, z)))
    objects: Mapping[str, Sequence[SeenObject]] = seen
    return labels_in_view(objects, pathfinder_of)


def walk_policy(
    policy: Policy, tasks: Sequence[Task], pathfinder_of: Callable[[Task], Pathfinder], eyes: Eyes | None = None
) -> Iterator[Prediction]:
    """Yield the predictions of a user's agent, one episode at a time."""
    for task in tasks:
        yield walk(task, policy, pathfinder_of(task), eyes=eyes)


def serve_split(export: Path, split: str, datasets: Sequence[str], host: str, port: int, sessions: int) -> None:
    """Serve a split until the process is ended.

    Parameters
    ----------
    datasets : ``FAMILY=FOLDER`` each, of what agents see
    sessions : how many may be open at once

    Raises
    ------
    UsageError : openenv is not installed, or the split is empty
    """
    from condvln.evaluation.environment.openenv_server import application
    from condvln.evaluation.environment.tools import tools_for

    tools = tools_for(export, split, datasets_of(datasets))
    app = application(tools, sessions)
    import uvicorn

    uvicorn.run(app, host=host, port=port)

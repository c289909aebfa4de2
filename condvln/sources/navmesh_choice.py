"""Which of a dataset's navmeshes a scene's episodes live on: the one built for the agent, else any with a warning."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from dataclasses import dataclass

from condvln.navigation.navmesh_file import MAX_FILE_BYTES, parse_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import NavmeshFile, SceneWarning
from condvln.sources.dataset_root import DatasetRoot
from condvln.sources.input_ledger import InputLedger
from condvln.sources.source import HashFile
from schemas.config import AgentConfig

__all__ = ["NavmeshChoice", "choose_navmesh", "shipped_navmeshes"]


@dataclass(frozen=True, slots=True)
class NavmeshChoice:
    """The navmesh taken (None: there is none), and what is to be said about it."""

    file: NavmeshFile | None
    warnings: tuple[SceneWarning, ...]


def shipped_navmeshes(
    root: DatasetRoot, scene_name: str, asked: str | None, configured: Sequence[str] = ()
) -> list[str]:
    """Where a scene's navmeshes may stand, the preferred ones first.

    In the folder that was asked for, where the dataset's configuration says, in every ``navmesh*`` folder of the
    root; under the names that the configuration uses, then under the scene's own.

    Raises
    ------
    PathEscapeError : the folder asked for is outside of the root
    """
    folders = [] if asked is None else [root.join("", asked)]
    beside = ["navmeshes", *sorted(p.name for p in root.folder.glob("navmesh*") if p.is_dir())]
    candidates: list[str] = []
    for name in dict.fromkeys([*map(posixpath.basename, configured), f"{scene_name}.navmesh"]):
        own = [path for path in configured if posixpath.basename(path) == name]
        candidates += [*(f"{f}/{name}" for f in folders), *own, *(f"{f}/{name}" for f in beside)]
    return candidates


def choose_navmesh(
    root: DatasetRoot, candidates: Sequence[str], agent: AgentConfig, hash_file: HashFile, ledger: InputLedger
) -> NavmeshChoice:
    """The first candidate whose settings fit the agent, else the first that is there, with a warning.

    Parameters
    ----------
    candidates : paths relative to the root, the preferred ones first; those that are not there are passed over
    ledger : notes every candidate that is there

    Raises
    ------
    FormatError : a candidate that had to be looked into is no sound navmesh
    """
    present = [path for path in dict.fromkeys(candidates) if root.has(path)]
    for path in present:
        ledger.file(path)
    settings_of: dict[str, NavMeshSettings] = {}
    for path in present:
        file = parse_navmesh(root.read(path, MAX_FILE_BYTES), str(root.folder / path))
        own = settings_of[path] = file.known_settings
        if own.fits(agent.radius, agent.height, agent.max_climb, agent.max_slope):
            return NavmeshChoice(_file(root, path, own, True, hash_file), ())
    if not present:
        message = f"none of {', '.join(candidates) or 'the usual places'} is there"
        return NavmeshChoice(None, (SceneWarning("no_navmesh", "navmesh", message),))
    path = present[0]
    own = settings_of[path]
    message = (
        f"{path} was built for radius {own.agent_radius}, height {own.agent_height}, climb {own.agent_max_climb}, "
        f"slope {own.agent_max_slope}, not for {agent.radius}, {agent.height}, {agent.max_climb}, {agent.max_slope}"
    )
    warning = SceneWarning("navmesh_does_not_fit", "navmesh", message)
    return NavmeshChoice(_file(root, path, own, False, hash_file), (warning,))


def _file(root: DatasetRoot, path: str, own: NavMeshSettings, fits: bool, hash_file: HashFile) -> NavmeshFile:
    _, sha256 = hash_file(root.path(path))
    return NavmeshFile(
        path=posixpath.normpath(path),
        sha256=sha256,
        built=False,
        fits=fits,
        agent_radius=own.agent_radius,
        agent_height=own.agent_height,
        agent_max_climb=own.agent_max_climb,
        agent_max_slope=own.agent_max_slope,
    )

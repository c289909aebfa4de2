"""The readers of all dataset families, by name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from condvln.sources.boxes import BoxesSource
from condvln.sources.gibson import GibsonSource
from condvln.sources.hm3d import Hm3dSource
from condvln.sources.mp3d import Mp3dSource
from condvln.sources.procthor import ProcthorHabitatSource, ProcthorSource
from condvln.sources.replicacad import HssdSource, ReplicaCadSource
from condvln.sources.scene_source import Absence, SceneChoice, Source, SourceOptions
from condvln.sources.source import HashFile, hash_file
from condvln.sources.thor import IthorSource, RobothorSource
from schemas.config import LimitsConfig
from schemas.errors import ConfigError

__all__ = ["READERS", "open_source"]

READERS: Final[dict[str, type[Source]]] = {
    reader.family: reader
    for reader in (
        *(BoxesSource, GibsonSource, Hm3dSource, HssdSource, IthorSource),
        *(Mp3dSource, ProcthorSource, ReplicaCadSource, RobothorSource),
    )
}
"""The reader of each family."""


def open_source(
    family: str,
    root: str | os.PathLike[str],
    *,
    scenes: Sequence[str] = ("*",),
    exclude: Sequence[str] = (),
    navmesh: str | None = None,
    regions: str | os.PathLike[str] | None = None,
    houses: str | os.PathLike[str] | None = None,
    hash_file: HashFile = hash_file,
    limits: LimitsConfig | None = None,
    absence: Absence = "complete",
    connectivity: str | os.PathLike[str] | None = None,
) -> Source:
    """Open the dataset of a family under `root`.

    Parameters
    ----------
    scenes, exclude : scene ids or patterns with ``*`` and ``?``, to read and to leave out
    navmesh : folder of navmeshes, relative to `root`, that is searched first
    regions : side file or folder of user-drawn room zones
    houses : folder of ProcTHOR's house JSON, if `root` is Habitat's scene dataset of ProcTHOR (ai2thor-hab)
    hash_file : returns size and SHA-256 of a file
    limits : the largest scene that is read; the configuration's defaults if None
    absence : with ``never``, conditions may also be about incompletely annotated rooms, and absence is never claimed
    connectivity : folder of Matterport3D's viewpoint graphs; the dataset's own ``connectivity`` if None

    Raises
    ------
    ConfigError : the family is unknown, the folder does not exist or holds another dataset, or a pattern matches no
        scene
    """
    if family not in READERS:
        raise ConfigError(f"unknown source family {family!r}", remedy=f"Known families: {', '.join(sorted(READERS))}")
    root = Path(root)
    if not root.is_dir():
        raise ConfigError(
            f"the {family} dataset folder does not exist",
            where=root,
            remedy="Download the dataset, or set the source's 'root' to its folder",
        )
    choice = SceneChoice(tuple(scenes), tuple(exclude))
    graphs = None if connectivity is None else Path(connectivity)
    side = None if regions is None else Path(regions)
    options = SourceOptions(choice, navmesh, side, hash_file, limits or LimitsConfig(), absence, graphs)
    if houses is None:
        return READERS[family](root, options)
    if family != ProcthorHabitatSource.family:
        raise ConfigError(
            f"the source of family {family!r} names houses, which only ProcTHOR has",
            remedy="Remove the source's 'houses', or set its 'family' to procthor",
        )
    houses = Path(houses)
    if not houses.is_dir():
        raise ConfigError("the folder of houses does not exist", where=houses, remedy="Correct the source's 'houses'")
    return ProcthorHabitatSource(root, options, houses)

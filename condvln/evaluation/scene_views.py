"""Open the scenes of an export's episodes for rendering, with a bounded cache."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from condvln.scene import Scene
from condvln.sensors import Renderer, open_renderer
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from schemas.errors import UsageError

__all__ = ["SCENES_KEPT", "SceneViews", "View"]

SCENES_KEPT: Final = 4
"""Number of scenes kept open; a large scan with its textures takes up to a gigabyte."""


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """What cameras need: a scene and its renderer, as `condvln.world.World` has them too."""

    scene: Scene
    renderer: Renderer


class SceneViews:
    """Opens scenes with their renderers, and keeps the latest ones open. A scene is called ``<source>/<scene id>``, the
    value that its tasks have on the axis ``scene``.

    Parameters
    ----------
    sources : the dataset of each family, or its folder
    kept : number of scenes kept open; the least recently used one is closed first
    """

    def __init__(self, sources: Mapping[str, Source | str | os.PathLike[str]], kept: int = SCENES_KEPT) -> None:
        self._sources = dict(sources)
        self._opened = lru_cache(maxsize=kept)(self._open)

    def __call__(self, name: str) -> View:
        """Return a scene and its renderer.

        Raises
        ------
        UsageError : no dataset was given for the scene's family
        InputError : the scene can't be read
        """
        return self._opened(name)

    def _open(self, name: str) -> View:
        family, _, scene_id = name.partition("/")
        source = self._source(family)
        scene = source.read(scene_id)
        return View(scene, open_renderer(scene, source.geometry(scene)))

    def _source(self, family: str) -> Source:
        found = self._sources.get(family)
        if found is None:
            raise UsageError(
                f"no dataset was given for the family {family!r}, so its scenes can't be rendered",
                remedy=f"Pass sources={{{family!r}: <its folder>}}, or disable cameras and text",
            )
        if isinstance(found, str | os.PathLike):
            self._sources[family] = found = open_source(family, found)
        return found

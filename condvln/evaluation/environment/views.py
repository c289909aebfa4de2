"""The scenes of an export's episodes as cameras see them, each opened once and kept while there is room."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from condvln.scene import Scene
from condvln.sensors import Renderer, open_renderer
from condvln.sources.registry import open_source
from condvln.sources.source import Source
from schemas.errors import UsageError

__all__ = ["SCENES_KEPT", "SceneViews", "View"]

SCENES_KEPT: Final = 4
"""Scenes kept open; a large scan with its textures takes up to a gigabyte."""


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """A scene and its renderer."""

    scene: Scene
    renderer: Renderer


class SceneViews:
    """Scenes by the axis ``scene`` of a task, ``<source>/<scene id>``.

    Parameters
    ----------
    sources : the dataset of each family, or its folder
    kept : scenes kept open; the one that was not asked for longest goes first
    """

    def __init__(self, sources: Mapping[str, Source | str | os.PathLike[str]], kept: int = SCENES_KEPT) -> None:
        self._sources = dict(sources)
        self._kept = kept
        self._open: OrderedDict[str, View] = OrderedDict()

    def __call__(self, name: str) -> View:
        """The view of a scene.

        Raises
        ------
        UsageError : no dataset was named for its family
        InputError : the scene can't be read
        """
        if name in self._open:
            self._open.move_to_end(name)
            return self._open[name]
        family, _, scene_id = name.partition("/")
        source = self._source(family)
        scene = source.read(scene_id)
        view = View(scene, open_renderer(scene, source.geometry(scene)))
        self._open[name] = view
        while len(self._open) > self._kept:
            self._open.popitem(last=False)
        return view

    def _source(self, family: str) -> Source:
        found = self._sources.get(family)
        if found is None:
            raise UsageError(
                f"no dataset of the family {family!r} was named, so that its scenes cannot be seen",
                remedy=f"Pass sources={{{family!r}: <its folder>}}, or ask for no cameras and no text",
            )
        if isinstance(found, str | os.PathLike):
            self._sources[family] = found = open_source(family, found)
        return found

"""Compose scenes that consist of several files into one GLB file, as stock loaders need it."""

from condvln.export.compose.scene import ComposedScene, compose_scene
from condvln.export.compose.writer import is_composed

__all__ = ["ComposedScene", "compose_scene", "is_composed"]

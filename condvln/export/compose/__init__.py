"""Scenes that come in parts as one GLB file, as stock loaders need it."""

from condvln.export.compose.scene import ComposedScene, compose_scene

__all__ = ["ComposedScene", "compose_scene"]

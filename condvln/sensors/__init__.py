"""What an agent sees of a scene, with no simulator: images of cameras, and text for agents that read none."""

from condvln.sensors.camera import PRESETS, cameras_of, panorama
from condvln.sensors.renderer import Frame, Renderer, measured_depth, open_renderer

__all__ = ["PRESETS", "Frame", "Renderer", "cameras_of", "measured_depth", "open_renderer", "panorama"]

"""What an agent perceives of a scene, without a simulator: camera images, and text for agents that can't read
images.
"""

from condvln.sensors.camera import PRESETS, cameras_of, noisy_move, noisy_pose, panorama
from condvln.sensors.renderer import Frame, Renderer, measured_depth, open_renderer
from condvln.sensors.text import KnownMap, SeenThing, TextObservation, TextSensor

__all__ = [
    "PRESETS",
    "Frame",
    "KnownMap",
    "Renderer",
    "SeenThing",
    "TextObservation",
    "TextSensor",
    "cameras_of",
    "measured_depth",
    "noisy_move",
    "noisy_pose",
    "open_renderer",
    "panorama",
]

"""Generate whole scenes in each source's native format, so that everything runs without a download."""

from condvln.samples.layout import Door, Furniture, Layout, Room, Yaw
from condvln.samples.maker import (
    FAMILIES,
    FORMS,
    SampleReport,
    make_layout,
    make_layouts,
    make_samples,
)

__all__ = [
    "FAMILIES",
    "FORMS",
    "Door",
    "Furniture",
    "Layout",
    "Room",
    "SampleReport",
    "Yaw",
    "make_layout",
    "make_layouts",
    "make_samples",
]

"""Cameras of a hub: presets, pairs and sweeps."""

from __future__ import annotations

import pytest

from condvln.trajectories.cameras import Sweep, hub_cameras, sweep_of
from schemas.errors import UsageError


def test_the_level_camera_of_a_pair_is_the_main_one() -> None:
    cameras = hub_cameras("streamvln", ("internvla-n1",))
    assert sorted(cameras) == ["depth.125cm_30deg", "rgb", "rgb.125cm_30deg"]


def test_a_sweep_has_a_camera_for_each_combination() -> None:
    sweep = sweep_of(["height=0.6,1.25", "pitch=15,30", "images=rgb,depth"])
    cameras = hub_cameras("streamvln", (), sweep)
    names = [
        f"{image}.{height}cm_{pitch}deg" for image in ("rgb", "depth") for height in (60, 125) for pitch in (15, 30)
    ]
    assert sorted(cameras) == sorted(["rgb", *names])
    low = cameras["depth.60cm_30deg"]
    assert (low.eye_height, low.look_down, low.hfov, low.width) == (0.6, 30.0, 79.0, 640)
    assert cameras["rgb"].look_down == 0


def test_angles_and_sizes_are_in_the_name() -> None:
    cameras = hub_cameras("vlnce", (), sweep_of(["hfov=79,90", "size=640x480"]))
    assert sorted(cameras) == ["rgb", "rgb.125cm_0deg_79fov_640x480", "rgb.125cm_0deg_90fov_640x480"]


@pytest.mark.parametrize(
    "text", ["height", "height=", "height=low", "tilt=3", "size=640", "images=infrared", "pitch=91"]
)
def test_a_wrong_sweep_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="sweep"):
        hub_cameras("streamvln", (), sweep_of([text]))


def test_no_sweep_adds_nothing() -> None:
    assert sweep_of([]) == Sweep()
    assert [*hub_cameras("snav", (), sweep_of([]))] == ["rgb"]

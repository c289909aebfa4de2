"""Sizes of actions: each layout's are its agent's own, and what can't be is refused."""

from __future__ import annotations

import pytest

from condvln.navigation.follower import ActionSpace
from condvln.trajectories.layouts import HUBS, MEANINGS, sized, with_hub
from condvln.verify import layouts
from schemas.config import TrajectoryConfig
from schemas.errors import UsageError


def test_the_verifier_has_the_same_meanings_in_its_own_words() -> None:
    assert MEANINGS == layouts.MEANINGS


def direct(**sizes: float) -> TrajectoryConfig:
    return TrajectoryConfig(walks=("direct",), **sizes)


def test_a_layout_sets_the_sizes() -> None:
    assert sized(direct(), ("uninavid", "lerobot")).turn == 30
    assert sized(direct(turn=30), ("uninavid",)).turn == 30
    assert sized(TrajectoryConfig(), ("navila", "janusvln")).turn == 15
    assert sized(direct(turn=45, forward=0.5), ("lerobot",)) == direct(turn=45, forward=0.5)


def test_looking_walks_have_one_size() -> None:
    """Where they turn to look, and see, is of steps of 0.25 m and turns of 15°."""
    with pytest.raises(UsageError, match=r"looking walks are made of steps of 0\.25 m and turns of 15°") as caught:
        sized(TrajectoryConfig(), ("snav",))
    assert "--walks direct" in (caught.value.remedy or "")
    with pytest.raises(ValueError, match=r"looking walks have steps of 0\.25 m"):
        TrajectoryConfig(turn=30)


@pytest.mark.parametrize("layouts", [("streamvln", "uninavid"), ("lerobot", "snav", "navila"), HUBS])
def test_layouts_of_other_sizes_do_not_share_walks(layouts: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match=r"means steps of 0\.25 m and turns of 30°") as caught:
        sized(TrajectoryConfig(), layouts)
    assert "folder of its own" in (caught.value.remedy or "")


@pytest.mark.parametrize(
    ("config", "layout", "place"),
    [
        (direct(turn=15), "uninavid", "--walk turn"),
        (direct(turn=30), "navila", "--walk turn"),
        (direct(forward=0.5), "streamvln", "--walk forward"),
    ],
)
def test_other_sizes_than_a_layout_means_are_refused(config: TrajectoryConfig, layout: str, place: str) -> None:
    with pytest.raises(UsageError, match="would mean other walks") as caught:
        sized(config, (layout,))
    assert caught.value.place == place


def test_annotations_are_streamvln_s_where_the_actions_are() -> None:
    assert with_hub(("navila",), TrajectoryConfig()) == ("streamvln", "navila")
    assert with_hub(("streamvln", "navila"), TrajectoryConfig()) == ("streamvln", "navila")
    assert with_hub(("uninavid",), direct(turn=30)) == ("uninavid",)
    assert with_hub(("snav",), direct(turn=30)) == ("snav",)


def test_a_turn_divides_the_circle() -> None:
    with pytest.raises(ValueError, match="must divide 360"):
        TrajectoryConfig(turn=25)
    assert ActionSpace(turn=direct(turn=22.5).turn).headings == 16

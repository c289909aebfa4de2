"""Keys that the command line sets: each kind of section reads the same forms and refuses the same faults."""

from __future__ import annotations

import pytest

from jobs.settings import read_section
from schemas.config import LookerConfig, TrajectoryConfig
from schemas.errors import ConfigError


def looker(*texts: str) -> LookerConfig:
    return read_section(LookerConfig, texts, option="--looker", example="noise.missed=0.1")


def test_keys_of_a_section_and_of_sections_in_it() -> None:
    default = LookerConfig()
    config = looker("noise.missed=0.1", "noise.false=0.2", "patience=0.5", "memory=null", "patience=0.6", "map=given")
    noise = default.noise.model_copy(update={"missed": 0.1, "false": 0.2})
    assert config == default.model_copy(update={"noise": noise, "patience": 0.6, "map": "given"})
    assert looker() == default


def test_given_keys_come_first() -> None:
    given = {"walks": ["direct", "oracle"], "jpeg_quality": 50}
    config = read_section(TrajectoryConfig, ("jpeg_quality=80",), option="--walk", example="x=1", given=given)
    assert config == TrajectoryConfig(walks=("direct", "oracle"), jpeg_quality=80)
    assert given["jpeg_quality"] == 50


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise", "--looker: 'noise' is not KEY=VALUE. Example: --looker noise.missed=0.1"),
        ("=1", "--looker: '=1' is not KEY=VALUE. Example: --looker noise.missed=0.1"),
        ("noise.missed=2", "--looker: noise.missed: must be at most 1, got 2"),
        ("noise.missed=[", "--looker noise.missed: the value is not YAML"),
        ("noise=3", "--looker: noise: a section with keys is expected, got 3"),
        ("pixels=many", "--looker: pixels: a whole number is expected, got 'many'"),
        ("memory.steps.most=3", "--looker: memory: a whole number is expected, got {"),
        ("noise.mised=0.1", "--looker: noise.mised: the key 'mised' is unknown. Did you mean missed?"),
        ("seed=1", "--looker: seed: the key 'seed' is unknown. Allowed here: noise, logic"),
    ],
)
def test_faults_name_the_option_and_the_key(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        looker(text)
    assert str(caught.value).startswith(message)

"""Every key that the evaluation of an agent reads resolves on our files, and has the value that the loop needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

LOOPS: dict[str, dict[str, Any]] = yaml.safe_load(
    Path(__file__).with_name("agent_loops.yaml").read_text(encoding="utf-8")
)


def configuration(exported: Path, loop: dict[str, Any]) -> dict[str, Any]:
    """What our files set: the experiment with the task file as ``TASK_CONFIG``, as VLN-CE's ``get_config`` puts them
    together, or habitat-lab's one file.
    """

    def read(name: str) -> dict[str, Any]:
        found: dict[str, Any] = yaml.safe_load((exported / "configs" / name).read_text(encoding="utf-8"))
        return found

    if "config" in loop:
        return read(loop["config"])
    found = read(loop["experiment"])
    assert found["BASE_TASK_CONFIG_PATH"].endswith(f"data/datasets/condvln/configs/{loop['task']}")
    return found | {"TASK_CONFIG": read(loop["task"])}


def value(found: Any, key: str) -> Any:
    """Raises KeyError if a part of the key is not there."""
    for part in key.split("."):
        found = found[part]
    return found


@pytest.mark.parametrize("agent", sorted(LOOPS))
def test_every_key_that_a_loop_reads_resolves(exported: Path, agent: str) -> None:
    loop = LOOPS[agent]
    ours = configuration(exported, loop)
    missing = []
    for key in loop["reads"]:
        try:
            value(ours, key)
        except (KeyError, TypeError):
            if key not in loop["defaults"]:
                missing.append(key)
    assert missing == []
    assert set(loop["defaults"]) <= set(loop["reads"])


@pytest.mark.parametrize("agent", sorted(LOOPS))
def test_a_loop_finds_the_values_that_it_needs(exported: Path, agent: str) -> None:
    """Set by our files, not left to a default. Mappings of actions keep their order: agents act by number."""
    loop = LOOPS[agent]
    ours = configuration(exported, loop)
    for key, wanted in loop["needs"].items():
        found = value(ours, key)
        assert found == wanted, key
        assert not isinstance(wanted, dict) or [*found] == [*wanted]


@pytest.mark.parametrize("agent", sorted(LOOPS))
def test_what_a_loop_takes_from_the_metrics_is_measured(exported: Path, agent: str) -> None:
    ours = configuration(exported, LOOPS[agent])
    place = "habitat.task.measurements" if "config" in LOOPS[agent] else "TASK_CONFIG.TASK.MEASUREMENTS"
    assert set(LOOPS[agent]["measures"]) <= set(value(ours, place))


def test_every_agent_with_a_configuration_of_its_own_is_here(exported: Path) -> None:
    """VLN-CE's files and habitat-lab's are for agents that bring their own experiment."""
    folders = {path.name for path in (exported / "configs").iterdir()} - {"vlnce", "habitat_lab"}
    used = {loop.get("config", loop.get("task", "")).split("/")[0] for loop in LOOPS.values()}
    assert used == folders

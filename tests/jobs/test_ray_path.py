"""Ray does the work of more than one worker, by its public names, and nothing else starts processes for it."""

from __future__ import annotations

import sys

import pytest

from factory.ray_executor import RayExecutor
from jobs.executor import open_executor
from schemas.config import RayConfig


@pytest.mark.ray
def test_two_workers_are_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with open_executor(RayConfig(workers=2)) as executor:
        assert isinstance(executor, RayExecutor)
        assert executor.begin(0.0) == 2
        assert executor.running
        assert sys.modules["ray"].cluster_resources()["CPU"] == 2

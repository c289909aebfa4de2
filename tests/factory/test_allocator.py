"""Processes that plan, generate and work take Arrow's memory from the C library."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

NAME = "ARROW_DEFAULT_MEMORY_POOL"

# What is imported first decides: an import of Arrow before the factory would leave Arrow's own allocator in place.
FIRST = (
    "factory",
    "factory.ray_executor",
    "factory.worker_process",
    "factory.worker_template",
    "jobs.generate",
    "jobs.plan",
    "jobs.rebuild",
)


def _allocator(module: str, **environment: str) -> str:
    """Return the name of Arrow's allocator in a process that imports a module first."""
    code = f"import jobs.command, {module}, pyarrow; print(pyarrow.default_memory_pool().backend_name)"
    clean = {name: value for name, value in os.environ.items() if name != NAME}
    done = subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.mark.parametrize("module", FIRST)
def test_memory_comes_from_the_c_library(module: str) -> None:
    assert _allocator(module) == "system"


def test_the_environment_may_choose_another() -> None:
    assert _allocator("factory", **{NAME: "mimalloc"}) == "mimalloc"

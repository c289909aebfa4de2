"""All kernels are compiled ahead, each group by the module that registers it."""

from __future__ import annotations

import re
from pathlib import Path

from jobs.warm_up import KERNEL_MODULES, compile_kernels


def test_every_group_that_is_registered_is_compiled(repository: Path) -> None:
    found = {}
    for file in (repository / "condvln").rglob("*.py"):
        for name in re.findall(r'^register_warm_up\("([^"]+)"', file.read_text(encoding="utf-8"), re.MULTILINE):
            found[name] = ".".join(file.relative_to(repository).with_suffix("").parts)
    assert found == KERNEL_MODULES


def test_what_the_cache_holds_is_not_compiled_again() -> None:
    said: list[str] = []
    compile_kernels(said.append, ("json scan",))
    report = compile_kernels(said.append, ("json scan",))
    assert report.document == {"compiled": {"json scan": 0}}
    assert said[-1] == "kernels 1/1: json scan, 0 compiled"

"""FCL measures surfaces on the path of ``condvln generate``, and nothing that proves the results uses it."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import fcl
import numpy as np
import pytest

import condvln
from condvln.relations import relate_room
from condvln.scene import OrientedBox, RoomArrays, SceneObject
from condvln.scene.rotations import rotation_y
from schemas.config import Thresholds

ROOT = Path(__file__).parents[3]
PACKAGES = ("schemas", "condvln", "factory", "jobs")


def modules() -> dict[str, Path]:
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


@cache
def imported(module: str) -> frozenset[str]:
    """What a module imports, inside functions too, and the packages above it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            names.update({node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)})
    names.update(name.rpartition(".")[0] for name in list(names))
    return frozenset(names)


def reached(module: str) -> set[str]:
    """Every module of ours that a module imports, by whatever way; the front door `condvln` names everything."""
    found, ahead = {module, "condvln"}, [module]
    while ahead:
        ahead += (new := {name for name in imported(ahead.pop()) if name in MODULES} - found)
        found |= new
    return found


def users_of_fcl() -> Iterator[str]:
    return (name for name in MODULES if "fcl" in imported(name))


def test_one_module_imports_fcl_and_generate_reaches_it() -> None:
    assert set(users_of_fcl()) == {"condvln.relations.collision"}
    assert "condvln.relations.collision" in reached("jobs.stages.scene")
    assert "jobs.stages.scene" in reached("jobs.generate")


def test_no_module_of_the_verifier_reaches_fcl() -> None:
    own = [name for name in MODULES if name.startswith("condvln.verify")]
    files = (Path(condvln.__file__).parent / "verify").rglob("*.py")
    assert len(own) == len([*files])
    assert not [name for name in own if reached(name) & set(users_of_fcl())]


def test_relations_of_turned_boxes_are_measured_by_fcl(
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[..., SceneObject],
    room_of: Callable[[Sequence[SceneObject]], RoomArrays],
) -> None:
    items = [make(name, (x, 0, 0), (0.5, 0.5, 0.5)) for name, x in (("a", 0.0), ("b", 1.4), ("c", 9.0))]
    turned = [replace(o, obb=OrientedBox(o.center, np.full(3, 0.3), rotation_y(np.pi / 4))) for o in items]
    asked = []
    measure = fcl.distance
    monkeypatch.setattr(fcl, "distance", lambda *pair: asked.append(pair) or measure(*pair))
    surface = relate_room(room_of(turned), Thresholds()).surface
    assert len(asked) == 1, "one pair is within reach"
    assert surface[0, 1] == round(1.4 - 0.6 * np.sqrt(2), 3)
    assert "fcl" in sys.modules

"""The navmesh of a scene in Habitat's form: which one is taken, and when it is refused."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.config import AgentConfig
from schemas.errors import FormatError
from tests.condvln.sources.replicacad_reading import codes, faults, on_navmesh


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"TESM", "file header"), (b"XXXX" + bytes(300), "not 'TESM'"), (None, "bytes")],
)
def test_a_broken_navmesh_is_refused(made: Any, data: bytes | None, message: str) -> None:
    file = made.root / "navmeshes_default/flat.navmesh"
    file.write_bytes(file.read_bytes()[:-7] if data is None else data)
    with pytest.raises(FormatError, match=message) as fault:
        on_navmesh(made)
    assert fault.value.where == str(file)


def test_the_navmesh_that_fits_the_agent_is_taken(made: Any) -> None:
    scene = on_navmesh(made)
    assert (scene.navmesh.path, scene.navmesh.fits, scene.navmesh.built) == (
        "navmeshes_default/flat.navmesh",
        True,
        False,
    )
    assert scene.navmesh.agent_radius == 0.1
    wide = on_navmesh(made, agent=AgentConfig(radius=0.3))
    assert (wide.navmesh.path, wide.navmesh.fits) == ("navmeshes/flat.navmesh", True)
    assert wide.warnings == ()


def test_else_a_shipped_one_with_a_warning(made: Any) -> None:
    scene = on_navmesh(made, agent=AgentConfig(radius=0.2))
    assert (scene.navmesh.path, scene.navmesh.fits, scene.navmesh.agent_radius) == (
        "navmeshes/flat.navmesh",
        False,
        0.3,
    )
    assert codes(scene) == ["navmesh_does_not_fit"]


def test_an_unknown_navmesh_handle_falls_back_to_the_scenes_name(made: Any) -> None:
    made.scene["navmesh_instance"] = "empty_stage_navmesh"
    made.write_scene()
    scene = on_navmesh(made)
    assert scene.navmesh.path == "navmeshes_default/flat.navmesh"
    assert codes(scene) == ["navmesh_handle_unknown"]


def test_a_dangling_navmesh_entry_is_no_fault(made: Any) -> None:
    made.scene["navmesh_instance"] = "withheld"
    made.write_scene("withheld")
    assert faults(made) == {"flat": None, "withheld": None}
    assert on_navmesh(made, "withheld").navmesh is None


def test_scenes_may_share_a_navmesh_of_either_radius(made: Any) -> None:
    made.write_scene("twin")
    assert [on_navmesh(made, name).navmesh for name in ("flat", "twin")] == [on_navmesh(made).navmesh] * 2


def test_an_asked_folder_of_navmeshes_comes_first(made: Any) -> None:
    made.navmesh("mine/flat.navmesh", 0.1)
    scene = on_navmesh(made, navmesh="mine")
    assert scene.navmesh.path == "mine/flat.navmesh"

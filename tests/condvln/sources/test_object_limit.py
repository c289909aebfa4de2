"""No family reads scenes of more objects than a building can have: relations grow with the square of their number."""

from __future__ import annotations

from pathlib import Path

import pytest

from condvln.samples import make_samples
from condvln.sources import gibson, house_file, scene_instance, thor_metadata
from condvln.sources.registry import open_source
from condvln.sources.source import MAX_OBJECTS
from schemas.errors import FormatError

READERS = {
    "gibson": gibson,
    "ithor": thor_metadata,
    "mp3d": house_file,
    "replicacad": scene_instance,
    "robothor": thor_metadata,
}
"""Where each family counts; a ProcTHOR house is bounded by the length of its line."""


@pytest.mark.parametrize("family", sorted(READERS))
def test_scenes_of_too_many_objects_are_refused(family: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_samples(tmp_path, family, 1, 4)
    source = open_source(family, tmp_path)
    scene_id = source.handles()[0].scene_id
    assert 5 < len(source.read(scene_id).objects) <= MAX_OBJECTS
    monkeypatch.setattr(READERS[family], "MAX_OBJECTS", 5)
    with pytest.raises(FormatError, match=r"more than 5 objects|at most 5"):
        source.read(scene_id)

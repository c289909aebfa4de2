"""Scans of Matterport3D made by hand: turned upright, joined with what lies beside, refused when broken."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene.tables import scene_tables
from condvln.sources.house_file import read_house_file
from condvln.sources.mp3d import Mp3dSource
from condvln.sources.registry import open_source
from schemas.config import AgentConfig
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError
from tests.broken_bytes import broken

SCAN = "made1234567"
ZEROS = "0 0 0 0 0"
BOX = "0 0 0 1 1 1"


def records() -> dict[str, list[str]]:
    """A kitchen (x 0–4, y 0–3) and, a storey up, a bedroom (x 0–4, y 0–3); a sofa turned by 90°, a lamp, a leftover."""
    return {
        "L": [f"L 0 1 1  0 0 0  {BOX}  {ZEROS}", f"L 1 1 2  0 0 3  {BOX}  {ZEROS}"],
        "R": [f"R 0 0  0 0  k  2 1.5 0  {BOX}  2.5  0 0 0 0", f"R 1 1  0 0  b  2 1.5 3  {BOX}  2.4  0 0 0 0"],
        "S": [f"S 0 0 0 F  0 0 0  0 0 1  {BOX}  {ZEROS}", f"S 1 1 0 F  0 0 3  0 0 1  {BOX}  {ZEROS}"],
        "V": [
            f"V {4 * s + i} {s} F  {x} {y} {3 * s}  0 0 1  0 0 0"
            for s in (0, 1)
            for i, (x, y) in enumerate([(0, 0), (4, 0), (4, 3), (0, 3)])
        ],
        "P": [f"P {'0123456789abcdef' * 2}  0 0 0  1 1 1.5  {ZEROS}"],
        "portal": ["P 0 0 1 -  0 0 0 1 1 1  0 0 0 0"],
        "I": ["I 0 0 " + " ".join(["x", *["0"] * 37])],
        "C": [f"C 0 1 sofa  10 sofa  {ZEROS}", f"C 1 2 table#lamp  28 lighting  {ZEROS}"],
        "O": [
            "O 0 0 0  1 1 0.4  0 1 0  1 0 0  1.0 0.5 0.4  0 0 0 0 0 0 0 0",
            "O 1 1 1  9 9 3.5  0 0 1  1 0 0  0.3 0.1 0.1  0 0 0 0 0 0 0 0",
            "O 2 0 -1  2 2 1  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0",
            "O 3 -1 0  2 2 1  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0",
            "O 4 0 0  3 2 1  1 0 0  1 0 0  1 1 1  0 0 0 0 0 0 0 0",
        ],
        "E": [f"E 0 0 7 0.5  0 0 0  {BOX}  {ZEROS}"],
    }  # fmt: skip


def text(made: dict[str, list[str]] | None = None, *, version: str = "ASCII 1.1", header: str | None = None) -> bytes:
    made = records() if made is None else made
    counts = " ".join(str(len(made[kind])) for kind in ("I", "P", "V", "S", "E", "O", "C", "R", "portal", "L"))
    first = header or f"H  -  -  {counts}  {ZEROS}  0 0 0 4 3 6  {ZEROS}"
    return "\n".join([version, first, *(line for lines in made.values() for line in lines)]).encode() + b"\n"


def write(root: Path, data: bytes, scan: str = SCAN, layout: str = "{scan}/{scan}.house") -> Mp3dSource:
    file = root / layout.format(scan=scan)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    source = open_source("mp3d", root)
    assert isinstance(source, Mp3dSource)
    return source


def test_a_scan_is_turned_upright(tmp_path: Path) -> None:
    scene = write(tmp_path, text()).read(SCAN)
    assert [(r.room_id, r.raw_label, r.label, r.level, r.floor_y, r.ceiling_y) for r in scene.rooms] == [
        ("region_0", "k", "kitchen", 0, 0.0, 2.5),
        ("region_1", "b", "bedroom", 1, 3.0, 5.4),
    ]
    assert scene.rooms[0].polygon.tolist() == [[0, 0], [4, 0], [4, -3], [0, -3]]
    sofa = scene.object_of["sofa_0"]
    assert (sofa.label, sofa.room_id, sofa.center.tolist()) == ("sofa", "region_0", [1, 0.4, -1])
    # Half lengths, along axes that are not in the order of the world's.
    assert sofa.aabb.tolist() == [[0.5, 0, -2], [1.5, 0.8, 0]]
    assert sofa.obb.half_extents.tolist() == [1.0, 0.5, 0.4]
    np.testing.assert_allclose(sofa.obb.rotation[:, 0], [0, 0, -1], atol=1e-9)


def test_the_region_decides_and_not_the_place(tmp_path: Path) -> None:
    lamp = write(tmp_path, text()).read(SCAN).object_of["table#lamp_1"]
    assert (lamp.room_id, lamp.label, lamp.raw_label) == ("region_1", "table lamp", "table#lamp")


def test_what_has_no_label_region_or_box_is_said(tmp_path: Path) -> None:
    scene = write(tmp_path, text()).read(SCAN)
    assert (scene.object_of["unknown_2"].label, scene.object_of["unknown_2"].geometry) == ("unknown", "obb")
    assert scene.object_of["sofa_4"].geometry == "radius"
    assert "sofa_3" not in scene.object_of
    assert [(w.code, w.where) for w in scene.warnings] == [
        ("no_box", "sofa_4"),
        ("object_outside_rooms", "sofa_3"),
        ("unlabelled_object", "unknown_2"),
    ]


def test_panoramas_and_portals_share_a_letter() -> None:
    house = read_house_file(text(), "x.house")
    (panorama,) = house.panoramas
    assert (panorama.name, panorama.region) == ("0123456789abcdef" * 2, 0)
    assert panorama.position.tolist() == [1, 1, 1.5]
    assert house.categories == {0: "sofa", 1: "table#lamp"}


@pytest.mark.parametrize(
    "layout",
    [
        "{scan}/{scan}.house",
        "{scan}/house_segmentations/{scan}.house",
        "scans/{scan}/house_segmentations/{scan}.house",
        "v1/scans/{scan}/house_segmentations/{scan}.house",
    ],
)
def test_every_layout_is_found_with_what_lies_beside(
    tmp_path: Path, layout: str, made: Any, glb_of_box: Callable[..., bytes]
) -> None:
    source = write(tmp_path, text(), layout=layout)
    folder = (tmp_path / layout.format(scan=SCAN)).parent
    folder = folder.parent if folder.name == "house_segmentations" else folder
    (folder / f"{SCAN}.glb").write_bytes(glb_of_box([1, 2, 3]))
    (folder / f"{SCAN}.navmesh").write_bytes((made.root / "navmeshes_default/flat.navmesh").read_bytes())
    scene = with_shipped_navmesh(source.read(SCAN), AgentConfig())
    assert scene.navmesh.fits
    (part,) = scene.stage
    np.testing.assert_array_equal(part.transform[:3, :3] @ [1, 2, 3], [1, 3, -2])
    (handle,) = source.handles()
    assert handle.scene_id == SCAN
    assert sorted(Path(i.path).suffix for i in handle.inputs) == [".glb", ".house", ".navmesh"]
    with pytest.raises(MissingFileError):
        source.read("other")


def test_a_floor_that_crosses_itself_is_mended(tmp_path: Path) -> None:
    made = records()
    made["V"][2:4] = [made["V"][2].replace("4 3 0", "0 3 0"), made["V"][3].replace("0 3 0", "4 3 0")]
    (room, _) = write(tmp_path, text(made)).read(SCAN).rooms
    assert shapely.Polygon(room.polygon).is_valid
    assert shapely.Polygon(room.polygon).area == pytest.approx(3.0)


def changed(kind: str, index: int, old: str, new: str) -> dict[str, list[str]]:
    made = records()
    assert old in made[kind][index]
    made[kind][index] = made[kind][index].replace(old, new, 1)
    return made


def test_an_object_of_negative_size_costs_its_extent_alone(tmp_path: Path) -> None:
    whole = write(tmp_path, text()).read(SCAN)
    scene = write(tmp_path, text(changed("O", 0, "0.5", "-0.5"))).read(SCAN)
    assert [o.object_id for o in scene.objects] == [o.object_id for o in whole.objects]
    (spoilt,) = [o for o in scene.objects if o.radius is None]
    assert (spoilt.aabb, spoilt.size) == (None, None)
    assert [w.message for w in scene.warnings if w.where == spoilt.object_id] == [
        "a half length is negative: extent unknown"
    ]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the first line is '', not 'ASCII 1.1'"),
        (text(version="ASCII 1.0"), "not 'ASCII 1.1'"),
        (text(version="ASCII 1."), "not 'ASCII 1.1'"),
        (b"ASCII 1.1\n", "there is no record H"),
        (b"\n".join(text().split(b"\n")[:-2]), "claims 1 records E, but there are 0"),
        (text()[:-20], "line 27: a record E must have 19 words, this one has 10"),
        (text(header="H 1 2"), "line 2: a record H must have 29 words, this one has 3"),
        (text(changed("O", 0, "0.5", "nan")), "word 14 is 'nan', not a number"),
        (text(changed("O", 0, "0.5", "1e7")), "not a number up to"),
        (text(changed("O", 0, "O 0 0 0", "O 0 7 0")), "in region 7, which does not exist"),
        (text(changed("O", 0, "O 0 0 0", "O 0 0 9")), "of category 9, which does not exist"),
        (text(changed("O", 0, "O 0 0 0", "O 1 0 0")), "two objects have the index 1"),
        (text(changed("O", 0, "O 0 0 0", "O 0.5 0 0")), "word 1 is '0.5', not a whole number"),
        (text(changed("O", 0, "O 0", f"O {'9' * 30}")), "too large"),
        (text(changed("R", 0, "R 0", "R 1")), "two regions have the index 1"),
        (text(changed("R", 0, "  2.5", "  0")), "region 0 has no height"),
        (text(changed("S", 0, "S 0 0", "S 0 1")), "region 0 has no floor"),
        (text(changed("L", 0, "L 0", "X 0")), "there is no record 'X'"),
    ],
)
def test_what_is_refused_and_how(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_house_file(data, "folder/x.house")
    assert caught.value.where == "folder/x.house"


def test_a_broken_scan_is_its_fault_alone(tmp_path: Path) -> None:
    write(tmp_path, text())
    source = write(tmp_path, text()[:-60], "broken")
    assert [h.scene_id for h in source.handles()] == ["broken", SCAN]
    with pytest.raises(FormatError):
        source.read("broken")
    assert len(source.read(SCAN).objects) == 4


def test_a_folder_without_scans_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no scans"):
        open_source("mp3d", tmp_path)


def test_a_large_file_is_read_in_bounded_memory() -> None:
    made = records()
    made["E"] = made["E"] * 100_000
    data = text(made)
    tracemalloc.start()
    try:
        assert len(read_house_file(data, "x.house").objects) == 5
        assert tracemalloc.get_traced_memory()[1] < len(data)
    finally:
        tracemalloc.stop()


@pytest.mark.rounds(15)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_house_or_our_error(tmp_path: Path, data: st.DataObject) -> None:
    tokens = [b" ", b"\n", b"-1", b"nan", b"9e9", b"P", b"O 0", b"0 0 0"]
    source = write(tmp_path, broken(data, text(), tokens, 5))
    with suppress(InputError):
        scene = source.read(SCAN)
        assert all(np.isfinite(o.center).all() for o in scene.objects)
        scene_tables(scene)

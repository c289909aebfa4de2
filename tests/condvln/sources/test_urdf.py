"""URDF links: where their meshes stand, and what is refused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from condvln.sources.urdf import read_urdf
from schemas.errors import FormatError
from tests.broken_bytes import broken

LINK = '<link name="{0}"><visual><geometry><mesh filename="{0}.glb"/></geometry></visual></link>'
VISUAL = '<link name="a"><visual><origin xyz="{}"/><geometry><mesh filename="m"/></geometry></visual></link>'
JOINT = '<joint name="{0}-{1}" type="revolute">{2}<parent link="{0}"/><child link="{1}"/></joint>'


def robot(*parts: str) -> bytes:
    return f'<?xml version="1.0"?><robot name="r">{"".join(parts)}</robot>'.encode()


angles = st.floats(-4, 4)
places = st.tuples(*[st.floats(-5, 5)] * 3)


@given(st.lists(st.tuples(st.tuples(angles, angles, angles), places), min_size=1, max_size=4), st.randoms())
def test_link_poses_multiply_along_the_chain(origins: list, shuffler) -> None:  # type: ignore[no-untyped-def,type-arg]
    parts = [LINK.format("l0")]
    expected = np.eye(4)
    for i, (rpy, xyz) in enumerate(origins):
        numbers = [" ".join(map(repr, v)) for v in (rpy, xyz)]
        parts += [
            LINK.format(f"l{i + 1}"),
            JOINT.format(f"l{i}", f"l{i + 1}", f'<origin rpy="{numbers[0]}" xyz="{numbers[1]}"/>'),
        ]
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
        expected = expected @ step
    shuffler.shuffle(parts)
    poses = {mesh.link: mesh.transform for mesh in read_urdf(robot(*parts), "r.urdf")}
    assert len(poses) == len(origins) + 1
    np.testing.assert_allclose(poses[f"l{len(origins)}"], expected, atol=1e-9)


@pytest.mark.parametrize("scale", ["2, 3, 4", "2 3 4", "2,3,4", " 2\t3\n4 "])
def test_numbers_are_separated_by_blanks_or_commas(scale: str) -> None:
    visual = f'<visual><origin xyz="1,0,0"/><geometry><mesh filename="m.glb" scale="{scale}"/></geometry></visual>'
    (mesh,) = read_urdf(robot(f'<link name="a">{visual}</link>'), "r.urdf")
    np.testing.assert_array_equal(mesh.transform, [[2, 0, 0, 1], [0, 3, 0, 0], [0, 0, 4, 0], [0, 0, 0, 1]])


def test_collision_shapes_and_primitives_are_passed_over() -> None:
    box = "<geometry><box size='1 1 1'/></geometry>"
    assert read_urdf(robot(f'<link name="a"><visual>{box}</visual><collision>{box}</collision></link>'), "r") == ()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not XML"),
        (b"<robot", "not XML"),
        (b"\xff\xfe\x00", "not XML"),
        (b"<sdf/>", "not <robot>"),
        (b'<!DOCTYPE r [<!ENTITY a "x">]><robot>&a;</robot>', "not allowed"),
        (robot(LINK.format("a"), LINK.format("a")), "two links are named 'a'"),
        (robot(LINK.format("a"), JOINT.format("a", "b", "")), "an unknown link 'b'"),
        (robot(LINK.format("a"), LINK.format("b"), JOINT.format("a", "b", ""), JOINT.format("b", "a", "")), "a cycle"),
        (robot(*map(LINK.format, "abc"), JOINT.format("a", "c", ""), JOINT.format("b", "c", "")), "two joints"),
        (
            robot(VISUAL.format("nan 0 0")),
            "three finite numbers",
        ),
        (
            robot(VISUAL.format("0 0")),
            "three finite numbers",
        ),
        (robot('<link name="a"><visual><geometry><mesh/></geometry></visual></link>'), "'filename' is missing"),
        (robot("<link/>"), "'name' is missing"),
        (robot(LINK.format("a"), '<joint name="j"><child link="a"/></joint>'), "no <parent>"),
    ],
)
def test_what_is_refused_and_how(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_urdf(data, "folder/r.urdf")
    assert caught.value.where == "folder/r.urdf"


def test_an_entity_bomb_is_refused() -> None:
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    with pytest.raises(FormatError, match="not allowed"):
        read_urdf(f'<!DOCTYPE r [<!ENTITY e0 "x">{entities}]><robot>&e11;</robot>'.encode(), "bomb.urdf")


@given(st.data())
def test_mutations_give_meshes_or_our_error(data: st.DataObject) -> None:
    sound = robot(LINK.format("a"), LINK.format("b"), JOINT.format("a", "b", '<origin xyz="1 2 3"/>'))
    with suppress(FormatError):
        assert all(np.isfinite(mesh.transform).all() for mesh in read_urdf(broken(data, sound, [b""]), "r.urdf"))

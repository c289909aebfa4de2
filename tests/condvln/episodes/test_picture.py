"""Pictures of episodes: labels cover neither each other nor marks, and walls are where the building's surfaces are."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from condvln.episodes.picture import HIGH, LOW, Label, draw_episode, place_labels, wall_lines
from condvln.scene import Room, Scene
from condvln.scene.scene import STRUCTURE, SceneGeometry


def test_labels_cover_nothing_and_the_needed_ones_are_all_there() -> None:
    figure = Figure(figsize=(8, 6))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(xlim=(0, 10), ylim=(0, 8))
    rng = np.random.default_rng(5)
    spots = rng.uniform([4, 3], [6, 5], (80, 2))
    marks = [(float(x), float(z), 6.0) for x, z in rng.uniform([4, 3], [6, 5], (5, 2))]
    labels = [Label(f"thing {k}", float(x), float(z), needed=k % 4 == 0) for k, (x, z) in enumerate(spots)]
    texts = place_labels(axes, labels, marks)
    placed = {text.get_text() for text in texts}
    assert {label.text for label in labels if label.needed} <= placed
    assert len(placed) < len(labels)  # crowded: some of the others have no room
    boxes = [text.get_window_extent().extents for text in texts]
    for x, z, radius in marks:
        column, row = axes.transData.transform((x, z))
        boxes.append(np.array([column - radius, row - radius, column + radius, row + radius]))
    frame = axes.get_window_extent().extents
    for one, other in itertools.combinations(range(len(boxes)), 2):
        if other < len(texts) or one < len(texts):
            a, b = boxes[one], boxes[other]
            assert (a[:2] >= b[2:]).any() or (a[2:] <= b[:2]).any()
    assert all((box[:2] >= frame[:2]).all() and (box[2:] <= frame[2:]).all() for box in boxes[: len(texts)])


def quad(*corners: tuple[float, float, float]) -> np.ndarray:
    """Two triangles (2, 3, 3) of four corners."""
    a, b, c, d = (np.array(corner, float) for corner in corners)
    return np.array([[a, b, c], [a, c, d]])


def test_walls_are_cut_at_breast_height() -> None:
    wall = quad((0, 0, 0), (4, 0, 0), (4, 2.5, 0), (0, 2.5, 0))
    lintel = quad((4, HIGH + 0.1, 0), (5, HIGH + 0.1, 0), (5, 2.5, 0), (4, 2.5, 0))
    sill = quad((5, 0, 0), (6, 0, 0), (6, LOW - 0.1, 0), (5, LOW - 0.1, 0))
    floor = quad((0, 0, 0), (6, 0, 0), (6, 0, 5), (0, 0, 5))
    thing = quad((1, 0, 2), (2, 0, 2), (2, 2.5, 2), (1, 2.5, 2))
    corners = np.concatenate([wall, lintel, sill, floor, thing]).reshape(-1, 3)
    owner = np.array([STRUCTURE] * 8 + [0] * 2)
    geometry = SceneGeometry(corners, np.arange(len(corners)).reshape(-1, 3), owner, False)
    polygon = np.array([[0, 0], [6, 0], [6, 5], [0, 5]], float)
    room = Room("room", "kitchen", "kitchen", 0, 0.0, 2.5, polygon, "dataset", True)
    scene = Scene("procthor", "made", Path(), (room,), ())
    lines = wall_lines(scene, geometry)
    assert len(lines) >= 1
    np.testing.assert_array_equal(lines[..., 1], 0)
    assert {tuple(sorted(line[:, 0])) for line in lines} == {(0.0, 4.0)}
    assert wall_lines(scene, None).shape == (0, 2, 2)


@pytest.mark.parametrize("lines", [3, 12, 25, 40])
def test_the_text_does_not_cover_the_legend(lines: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A deep tree has dozens of lines, and some of them are broken."""
    polygon = np.array([[0, 0], [6, 0], [6, 5], [0, 5]], float)
    room = Room("room", "kitchen", "kitchen", 0, 0.0, 2.5, polygon, "dataset", True)
    points = [{"x": x, "y": 0.0, "z": 1.0} for x in (1.0, 5.0)]
    episode = {
        "category": "deep_nested", "episode_id": 1, "instruction_text": "Go to the fridge in the kitchen there. " * 15,
        "start_position": points[0], "start_heading_degrees": 90.0, "gold_leaf": 0,
        "leaves": [{"leaf": k, "object_id": "", "reference_path": points, "subgoals": []} for k in range(2)],
    }  # fmt: skip
    kept: list[Figure] = []
    monkeypatch.setattr("condvln.episodes.picture.write_figure", lambda figure, path, dpi: kept.append(figure))
    tree = "\n".join(
        f"{'    ' * (k % 5)}ELSE [{k}] picture north-west of table lamp (Picture|5|37)" for k in range(lines)
    )
    view = np.zeros((60, 80, 3), np.uint8)
    draw_episode(tmp_path / "x.png", Scene("made", "x", Path(), (room,), ()), (), episode, tree, view=view)
    _, _, words, key = kept[0].axes
    (text,) = words.texts
    assert text.get_window_extent().y0 >= key.get_legend().get_window_extent().y1
    assert text.get_fontsize() == 9 or lines > 3

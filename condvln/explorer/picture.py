"""A plan with the ways to all leaves as one SVG file, for places where the page itself is not at hand."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final
from xml.sax.saxutils import escape

__all__ = ["plan_picture"]

WIDTH: Final = 640
HEIGHT: Final = 560
MARGIN: Final = 16
FONT: Final = 11
GOLD: Final = "#00704f"
LEAVES: Final = ("#b34700", "#0062a3", "#9b3f79", "#5d5d00")
DASHES: Final = ("8 5", "2 5", "12 4 2 4", "5 3")
_FLAT: Final = ("floor", "ceiling")
_UNSEEN: Final = re.compile(
    r"[\x00-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufffe\uffff\ud800-\udfff]"
)

Point = tuple[float, float]


def plan_picture(plan: Mapping[str, Any], episode: Mapping[str, Any]) -> bytes:
    """Return a scene's plan with an episode's start, stops and ways as an SVG file; equal documents give equal bytes.
    North is up. The gold leaf is green with a star, the looking path to it dotted.

    Parameters
    ----------
    plan : what :func:`~condvln.explorer.plan.plan_document` returns
    episode : what :func:`~condvln.explorer.episode.episode_document` returns
    """
    drawing = _Drawing(plan, episode)
    drawing.floor()
    drawing.rooms()
    drawing.objects()
    for leaf in sorted(episode["leaves"], key=lambda one: one["leaf"] == episode["gold"]):
        drawing.leaf(leaf, gold=leaf["leaf"] == episode["gold"])
    if episode["looking"] is not None:
        drawing.looking(episode["looking"]["path"])
    drawing.start()
    drawing.labels()
    return drawing.svg()


class _Drawing:
    def __init__(self, plan: Mapping[str, Any], episode: Mapping[str, Any]) -> None:
        self._plan, self._episode = plan, episode
        points = list(_points(plan, episode))
        west, north = (min(point[axis] for point in points) for axis in (0, 1))
        east, south = (max(point[axis] for point in points) for axis in (0, 1))
        self._scale = min((WIDTH - 2 * MARGIN) / max(east - west, 0.5), (HEIGHT - 2 * MARGIN) / max(south - north, 0.5))
        self._west, self._north = west, north
        self._width = math.ceil((east - west) * self._scale) + 2 * MARGIN
        self._height = math.ceil((south - north) * self._scale) + 2 * MARGIN
        self._parts: list[str] = []
        self._taken: list[tuple[float, float, float, float]] = []

    def floor(self) -> None:
        paths = (zip(polygon[1::2], polygon[2::2], strict=True) for polygon in self._plan["floor"])
        outline = "".join(f"M{'L'.join(self._at(corner) for corner in corners)}Z" for corners in paths)
        if outline:
            self._add(f'<path d="{outline}" fill="#e3ecf5" stroke="#e3ecf5"/>')

    def rooms(self) -> None:
        for room in self._plan["rooms"]:
            if room["polygon"]:
                self._polygon(room["polygon"], 'fill="none" stroke="#5f6975" stroke-width="3"')

    def objects(self) -> None:
        for item in sorted(self._plan["objects"], key=_area, reverse=True):  # small things lie on large ones
            if item["structure"] and item["label"] in _FLAT:
                continue
            own = item["id"] in self._named()
            fill = "#5f6975" if item["structure"] else "#ffe08a" if own else "#d9d4c9"
            style = f'fill="{fill}" stroke="#7a7468"' + (' fill-opacity=".25"' if item["structure"] else "")
            for shape in item["shape"]:
                self._polygon(zip(shape[::2], shape[1::2], strict=True), style)

    def leaf(self, leaf: Mapping[str, Any], *, gold: bool) -> None:
        colour = GOLD if gold else LEAVES[leaf["leaf"] % len(LEAVES)]
        dash = "" if gold else f' stroke-dasharray="{DASHES[leaf["leaf"] % len(DASHES)]}"'
        way = " ".join(self._at((corner[0], corner[2])) for corner in leaf["path"])
        self._add(f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-width="{3.5 if gold else 2}"{dash}/>')
        for k, stop in enumerate(leaf["stops"]):
            self._mark(stop["at"], colour, str(k + 1), "circle")
        self._mark(leaf["path"][-1], colour, str(leaf["leaf"]), "star" if gold else "square")

    def looking(self, path: Iterable[Sequence[float]]) -> None:
        way = " ".join(self._at((corner[0], corner[2])) for corner in path)
        self._add(f'<polyline points="{way}" fill="none" stroke="{GOLD}" stroke-width="2" stroke-dasharray="1 5"/>')

    def start(self) -> None:
        x, y = self._place((self._episode["start"][0], self._episode["start"][2]))
        turn = math.radians(self._episode["heading"])
        ahead, aside = (math.sin(turn), -math.cos(turn)), (math.cos(turn), math.sin(turn))
        tip = (x + 18 * ahead[0], y + 18 * ahead[1])
        wings = [(tip[0] - 6 * ahead[0] + k * 5 * aside[0], tip[1] - 6 * ahead[1] + k * 5 * aside[1]) for k in (-1, 1)]
        line = f"M{x:.1f} {y:.1f}L{tip[0]:.1f} {tip[1]:.1f}" + "".join(
            f"M{tip[0]:.1f} {tip[1]:.1f}L{wing[0]:.1f} {wing[1]:.1f}" for wing in wings
        )
        self._add(f'<path d="{line}" stroke="#123a9b" stroke-width="3"/><circle cx="{x:.1f}" cy="{y:.1f}" r="6" '
                  'fill="#123a9b"/>')  # fmt: skip
        self._taken.append((x - 8, y - 8, x + 8, y + 8))

    def labels(self) -> None:
        """Write the names of things and rooms, but leave out a name for which no room is left. The things that the
        episode names come first, then rooms, then furniture.
        """
        objects = [item for item in self._plan["objects"] if item["shape"] and not item["structure"]]
        own = [item for item in objects if item["id"] in self._named()]
        for item in own:
            self._label((item["center"][0], item["center"][2]), item["label"], "font-weight='600'")
        for room in self._plan["rooms"]:
            if room["polygon"]:
                xs, zs = zip(*room["polygon"], strict=True)
                middle = ((min(xs) + max(xs)) / 2, (min(zs) + max(zs)) / 2)
                self._label(middle, room["label"], "font-style='italic'")
        for item in objects:
            if item not in own and max(_sides(item["shape"][0])) * self._scale > 4 * FONT:
                self._label((item["center"][0], item["center"][2]), item["label"], "fill='#535b66'")

    def svg(self) -> bytes:
        title = f"Plan of {self._episode['source']}/{self._episode['scene']}, episode {self._episode['id']}"
        metres = next((m for m in (5, 2, 1) if m * self._scale < self._width / 3), 0.5)
        foot = self._height + 14
        scale = (
            f'<path d="M8 {foot - 4}V{foot}H{8 + metres * self._scale:.1f}V{foot - 4}" fill="none" stroke="#535b66"/>'
            f'<text x="12" y="{foot - 4}" text-anchor="start">{metres:g} m, north is up</text>'
        )
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self._width} {self._height + 20}" '
            f'width="{self._width}" height="{self._height + 20}" font-family="sans-serif" font-size="{FONT}" '
            f'text-anchor="middle" role="img"><title>{_text(title)}</title>'
            '<rect width="100%" height="100%" fill="#fff"/>'
        )
        return "\n".join((head, *self._parts, scale, "</svg>\n")).encode()

    def _named(self) -> set[str]:
        """Return the ids of the things that the gold leaf and the conditions speak of."""
        program = self._episode["program"]
        found = {one for condition in program["conditions"] for one in condition["witnesses"]}
        for condition in program["conditions"]:
            found |= {anchor["object_id"] for anchor in (condition["qualifier"] or {}).get("anchors", ())}
        for leaf in self._episode["leaves"]:
            found |= {leaf["object"], *(stop["object"] for stop in leaf["stops"])}
        return found

    def _label(self, point: Point, text: str, style: str) -> None:
        x, y = self._place(point)
        half = len(text) * FONT * 0.29 + 2
        for off in (0, -13, 13):
            box = (x - half, y + off - FONT * 0.6, x + half, y + off + FONT * 0.6)
            inside = box[0] >= 0 and box[1] >= 0 and box[2] <= self._width and box[3] <= self._height
            if inside and not any(_overlap(box, other) for other in self._taken):
                self._taken.append(box)
                self._add(
                    f'<text x="{x:.1f}" y="{y + off + 4:.1f}" {style} paint-order="stroke" stroke="#fff" '
                    f'stroke-width="3">{_text(text)}</text>'
                )
                return

    def _mark(self, position: Sequence[float], colour: str, text: str, shape: str) -> None:
        x, y = self._place((position[0], position[2]))
        if shape == "star":
            corners = [(x + r * math.sin(k * math.pi / 5), y - r * math.cos(k * math.pi / 5))
                       for k, r in enumerate((13.0, 6.0) * 5)]  # fmt: skip
            drawn = f'<polygon points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in corners)}"'
        elif shape == "circle":
            drawn = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8"'
        else:
            drawn = f'<rect x="{x - 7:.1f}" y="{y - 7:.1f}" width="14" height="14" rx="2"'
        self._add(f'{drawn} fill="{colour}" stroke="#fff"/><text x="{x:.1f}" y="{y + 4:.1f}" fill="#fff" '
                  f'font-weight="700">{_text(text)}</text>')  # fmt: skip
        self._taken.append((x - 9, y - 9, x + 9, y + 9))

    def _polygon(self, corners: Iterable[Sequence[float]], style: str) -> None:
        self._add(f'<polygon points="{" ".join(self._at((x, z)) for x, z in corners)}" {style}/>')

    def _place(self, point: Point) -> Point:
        return (point[0] - self._west) * self._scale + MARGIN, (point[1] - self._north) * self._scale + MARGIN

    def _at(self, point: Point) -> str:
        x, y = self._place(point)
        return f"{x:.1f},{y:.1f}"

    def _add(self, part: str) -> None:
        self._parts.append(part)


def _points(plan: Mapping[str, Any], episode: Mapping[str, Any]) -> Iterable[Point]:
    """Yield all points that the picture must contain."""
    yield episode["start"][0], episode["start"][2]
    for leaf in episode["leaves"]:
        yield from ((corner[0], corner[2]) for corner in leaf["path"])
    for room in plan["rooms"]:
        yield from ((x, z) for x, z in room["polygon"] or ())
    for item in plan["objects"]:
        if not (item["structure"] and item["label"] in _FLAT):
            for shape in item["shape"]:
                yield from zip(shape[::2], shape[1::2], strict=True)
    for polygon in plan["floor"]:
        yield from zip(polygon[1::2], polygon[2::2], strict=True)


def _sides(shape: Sequence[float]) -> tuple[float, float]:
    """Return the lengths of the two sides of a rectangle, metres."""
    return math.dist(shape[0:2], shape[2:4]), math.dist(shape[2:4], shape[4:6])


def _area(item: Mapping[str, Any]) -> float:
    """Return the area of an object's footprint, m²."""
    return sum(math.prod(_sides(shape)) for shape in item["shape"])


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _text(text: str) -> str:
    """Return a text escaped for SVG; invisible characters are replaced by their codes, such as ⟨U+200B⟩."""
    return escape(_UNSEEN.sub(lambda found: f"⟨U+{ord(found[0]):04X}⟩", text))

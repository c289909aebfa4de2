"""Resolve the phrases of a text in a scene: which rooms and objects the phrases mean, and whether the claims about
these are true.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import cached_property
from typing import Any, NamedTuple

from condvln.kept import kept
from condvln.scene import Scene, SceneObject
from condvln.verify.containment import said_of, shut_away
from condvln.verify.likeness import astride_rooms, left_apart
from condvln.verify.phrases import Named, Phrase
from condvln.verify.predicates import FALSE, TRUE, Judge, Judgement, Thing
from condvln.verify.room_view import RoomView, longest_side, model_of
from condvln.verify.standpoint import BEARINGS, Standpoint
from condvln.verify.surfaces import Shapes, SurfaceGauge
from condvln.verify.words import words
from schemas.config import Thresholds
from schemas.config.constants import LANDMARK_SIZE

__all__ = ["Answer", "Problem", "Referent", "SceneReferents"]


class Problem(NamedTuple):
    """Why a phrase has no certain meaning: the fact that fails, what the text needs, and what the scene has."""

    fact: str
    needed: Any
    found: Any


class Referent(NamedTuple):
    """The one object that a phrase refers to, and the objects that its qualifier and its room's name rely on."""

    object_id: str
    room_id: str
    anchor_ids: tuple[str, ...]
    room_anchor_id: str | None


class Answer(NamedTuple):
    """Whether a claim holds, its witnesses, and the measurements of the object that decides it.

    definite : the claim is a relation, and its label fits exactly one object of the room
    """

    truth: bool
    definite: bool
    witnesses: frozenset[str]
    room_id: str
    anchor_ids: tuple[str, ...]
    room_anchor_id: str | None
    numbers: Mapping[str, float | None]


class SceneReferents:
    """Resolves the phrases of all texts of one scene; each phrase is resolved once.

    anchor_size : metres; an object that is smaller and not fixed can't be an anchor
    labels : those of the same scene, made before it was known what can be seen; what is shut away is taken from there
    """

    def __init__(
        self,
        scene: Scene,
        thresholds: Thresholds,
        anchor_size: float,
        shapes: Shapes,
        can_be_seen: Callable[[str], bool] = lambda object_id: True,
        labels: SceneReferents | None = None,
    ) -> None:
        self.scene = scene
        self._anchor_size, self._thresholds = anchor_size, thresholds
        self._pieces = left_apart(scene)
        self.meaning = words()
        self.judge = Judge(thresholds, SurfaceGauge(shapes))
        held: dict[str, list[SceneObject]] = {room.room_id: [] for room in scene.rooms}
        for item in scene.objects:
            held.setdefault(item.room_id, []).append(item)
        if labels is None:
            self.hidden = shut_away(scene.objects, scene.family, self._label, self.meaning)
            self.said = said_of(scene.objects, self._label, self.meaning)
            self.astride = astride_rooms(scene, self._label, self.meaning)
        else:
            self.hidden, self.said, self.astride = labels.hidden, labels.said, labels.astride
        self._held, self._can_be_seen = held, can_be_seen
        self._things: dict[Phrase, Referent | Problem] = {}
        self._claims: dict[Phrase, Answer | Problem] = {}
        self._related: dict[tuple[str, str, str, tuple[str, ...], bool], list[tuple[Thing, Judgement]]] = {}

    @cached_property
    def rooms(self) -> dict[str, RoomView]:
        """The rooms of the scene by id, with what words may mean there."""
        types = self._room_types(self._held)
        return {
            room.room_id: RoomView(
                room,
                types[room.room_id],
                self._held[room.room_id],
                self.scene.family,
                self.meaning,
                self.hidden,
                self._can_be_seen,
                self._thresholds,
                self.said,
                frozenset(item.object_id for item, _ in self.astride if item.room_id == room.room_id),
                frozenset(self._label(item) for item, others in self.astride if room.room_id in others),
            )
            for room in self.scene.rooms
        }

    @property
    def single_room(self) -> bool:
        """Whether the scene is one room, so that texts need not name the room."""
        return self.scene.single_room

    def _label(self, item: SceneObject) -> str:
        return self.meaning.label(item.raw_label, self.scene.family, model_of(item))

    def _room_types(self, held: Mapping[str, Sequence[SceneObject]]) -> dict[str, str]:
        """Return the type of each room: that of the source, or what shows in the room's objects if the source has no
        word for the room. Only scans of Matterport3D have such rooms.
        """
        types = {room.room_id: self.meaning.room_type(room.raw_label, self.scene.family) for room in self.scene.rooms}
        if self.scene.family != "mp3d":
            return types
        unnamed = {
            room_id: [self._label(item) for item in held[room_id]]
            for room_id, label in types.items()
            if self.meaning.any_room(label)
        }
        for around in (None, types):
            shown = {
                room_id: self.meaning.shown_types(labels, None if around is None else frozenset(around.values()))
                for room_id, labels in unnamed.items()
                if self.meaning.any_room(types[room_id])
            }
            types.update({room_id: next(iter(found)) for room_id, found in shown.items() if len(found) == 1})
        return types

    def is_structure(self, item: SceneObject) -> bool:
        """Return whether an object is structure, such as a wall or floor."""
        return self._label(item) in self.meaning.structure

    def is_frame(self, item: SceneObject) -> bool:
        """Return whether an object is a frame (shelf, table), whose box is mostly air."""
        return self._label(item) in self.meaning.frames

    @kept
    def room(self, named: Named | None) -> tuple[RoomView, str | None] | Problem:
        """Return the room that a name refers to, and the id of the object that the name relies on."""
        if named is None:
            if self.single_room:
                return next(iter(self.rooms.values())), None
            return Problem("room_unique", "a room's name", f"none, in a scene of {len(self.rooms)} rooms")
        meant = self.meaning.rooms_meant_by(named.label)
        general = self.meaning.any_room(named.label)
        candidates = [view for view in self.rooms.values() if general or view.label in meant]
        if named.anchor is None:
            if not general and len(candidates) == 1 and candidates[0].label == named.label:
                return candidates[0], None
            return Problem("room_unique", f"one {named.label}", [view.room.room_id for view in candidates])
        if len(candidates) < 2:
            return Problem("room_anchor_needed", f"several rooms like a {named.label}", len(candidates))
        having = [view for view in candidates if view.meant(named.anchor) or view.unknown(named.anchor)]
        anchor = having[0].only(named.anchor) if len(having) == 1 else None
        if anchor is not None and anchor.item.geometry == "none":
            return Problem("anchor_extent", f"a {named.anchor} of known extent", anchor.object_id)
        if anchor is None or having[0].label != named.label:
            found = {view.room.room_id: len(view.meant(named.anchor)) for view in having}
            return Problem("room_unique", f"one {named.label} with one {named.anchor}", found)
        if not self._marks(anchor):
            return Problem("anchor_fit", "something large or fixed", anchor.object_id)
        others = [view for view in candidates if view is not having[0]]
        unsure = [view.room.room_id for view in others if not view.knows_absence(named.anchor)]
        if unsure:
            return Problem("absence_known", f"rooms known to have no {named.anchor}", unsure)
        return having[0], anchor.object_id

    def thing(self, phrase: Phrase, start: Standpoint | None = None) -> Referent | Problem:
        """Return the one object that a stop's phrase refers to. Return a `Problem` if there is no such object, or if
        the phrase has a qualifier that is superfluous or not sufficient.

        start : the agent's start pose, for left, right, ahead and behind
        """
        if phrase.qualifier is not None and phrase.qualifier[0] in BEARINGS:
            return self._thing_at(phrase, start)
        if phrase not in self._things:
            found = self._thing(phrase)
            if isinstance(found, Referent):
                used = {found.object_id, *found.anchor_ids, found.room_anchor_id}
                found = self._cut(used) or found
            self._things[phrase] = found
        return self._things[phrase]

    def claim(self, phrase: Phrase, start: Standpoint | None = None) -> Answer | Problem:
        """Return whether the object that `phrase` names certainly exists or certainly does not; a `Problem` if this is
        not certain. Left, right, ahead and behind are as seen from `start`.
        """
        if phrase.qualifier is not None and phrase.qualifier[0] in BEARINGS:
            return self._claim_at(phrase, start)
        if phrase not in self._claims:
            found = self._claim(phrase)
            if isinstance(found, Answer):
                used = {*found.witnesses, *found.anchor_ids, found.room_anchor_id}
                found = self._cut(used) or found
            self._claims[phrase] = found
        return self._claims[phrase]

    def _cut(self, used: Set[str | None]) -> Problem | None:
        """Return a problem if some object in `used` is only a piece of an object that was cut at a region's border,
        else None.
        """
        pieces = sorted(name for name in used if name in self._pieces)
        return Problem("whole_object", "things that no region border cuts", pieces) if pieces else None

    def _anchors(self, view: RoomView, labels: Sequence[str]) -> tuple[Thing, ...] | Problem:
        found: list[Thing] = []
        for label in labels:
            anchor = view.only(label)
            if anchor is not None and anchor.item.geometry == "none":
                return Problem("anchor_extent", f"a {label} of known extent", anchor.object_id)
            if anchor is None or anchor in found:
                return Problem("anchor_unique", f"one {label}", [thing.object_id for thing in view.meant(label)])
            if not self._marks(anchor):
                return Problem("anchor_fit", "something large or fixed", anchor.object_id)
            found.append(anchor)
        return tuple(found)

    def _marks(self, anchor: Thing) -> bool:
        """Return whether an object may be an anchor: its size is known, it is fixed or large, and not portable."""
        side = longest_side(anchor)
        if side is None or anchor.label in self.meaning.roles["portable"]:
            return False
        return self._is_fixed(anchor) or side >= self._anchor_size

    def _is_fixed(self, thing: Thing) -> bool:
        """Return whether an object stays in place: built in, heavy, or a large landmark."""
        roles, side = self.meaning.roles, longest_side(thing)
        if thing.label in roles["fixed"]:
            return True
        return thing.label in roles["landmark"] and side is not None and side >= LANDMARK_SIZE

    def _carries_the_phrase(self, anchors: Iterable[Thing], things: Iterable[Thing]) -> bool:
        """Return whether each anchor is fixed, or at least as large as each of `things` in ground area or volume."""
        things = tuple(things)
        for anchor in anchors:
            if self._is_fixed(anchor):
                continue
            for thing in things:
                if thing.box is None or not (
                    math.prod(anchor.ground_sides()) >= math.prod(thing.ground_sides())
                    or anchor.volume() >= thing.volume()
                ):
                    return False
        return True

    def _relations(
        self, view: RoomView, label: str, predicate: str, anchors: tuple[Thing, ...], asked: bool
    ) -> list[tuple[Thing, Judgement]]:
        """Return each object that `label` might mean, visible or not, with the judgement on whether it has the relation
        `predicate` to the anchors.
        """
        key = (view.room.room_id, label, predicate, tuple(anchor.object_id for anchor in anchors), asked)
        if key not in self._related:
            meant, self._related[key] = view.meant(label), []
            for x in (*meant, *view.unknown(label)):
                if x not in anchors:
                    rivals = [rival for rival in meant if rival is not x]
                    how = self.judge(predicate, x, anchors, view.surroundings, rivals, asked)
                    self._related[key].append((x, how))
        return self._related[key]

    def _thing(self, phrase: Phrase) -> Referent | Problem:
        room = self.room(phrase.room)
        if isinstance(room, Problem):
            return room
        view, room_anchor = room
        if view.may_be_foreign(phrase.label):
            return _of_two_rooms(view, phrase.label)
        meant = view.meant(phrase.label)
        if phrase.qualifier is None:
            only = view.only(phrase.label)
            if only is None:
                return Problem("referent_unique", f"one {phrase.label}", [thing.object_id for thing in meant])
            return Referent(only.object_id, view.room.room_id, (), room_anchor)
        predicate, labels = phrase.qualifier
        anchors = self._anchors(view, labels)
        if isinstance(anchors, Problem):
            return anchors
        if len(meant) < 2:
            return Problem("qualifier_needed", f"several things like a {phrase.label}", len(meant))
        related = [(x, how) for x, how in self._relations(view, phrase.label, predicate, anchors, False) if x in meant]
        chosen = _the_one(view, phrase, related)
        if isinstance(chosen, Problem):
            return chosen
        if predicate in ("bigger", "smaller") and (twin := view.has_twin(chosen)) is not None:
            return Problem("referent_single", f"{phrase.label}s of different heights", sorted(_ids((chosen, twin))))
        if not self._carries_the_phrase(anchors, (chosen,)):
            return Problem("anchor_fit", f"an anchor larger than {chosen.object_id}", _ids(anchors))
        return Referent(chosen.object_id, view.room.room_id, _ids(anchors), room_anchor)

    def _claim(self, phrase: Phrase) -> Answer | Problem:
        room = self.room(phrase.room)
        if isinstance(room, Problem):
            return room
        view, room_anchor = room
        if view.may_be_foreign(phrase.label):
            return _of_two_rooms(view, phrase.label)
        if phrase.qualifier is None:
            anchors: tuple[Thing, ...] = ()
            numbers: Mapping[str, float | None] = {}
            possible = (*view.meant(phrase.label), *view.unknown(phrase.label))
            sure = [thing for thing in view.meant(phrase.label) if thing.label == phrase.label]
            found: Any = [thing.object_id for thing in possible]
            sure = [thing for thing in sure if view.is_itself(thing)]
        else:
            predicate, labels = phrase.qualifier
            anchored = self._anchors(view, labels)
            if isinstance(anchored, Problem):
                return anchored
            called = [x for x in view.meant(phrase.label) if x.label == phrase.label and view.is_itself(x)]
            if not self._carries_the_phrase(anchored, called):
                return Problem("anchor_fit", f"an anchor larger than any {phrase.label}", _ids(anchored))
            related = self._relations(view, phrase.label, predicate, anchored, True)
            seen = [(thing, how) for thing, how in related if view.is_seen(thing)]
            sure = [thing for thing, how in seen if how.verdict == TRUE and thing.label == phrase.label]
            sure = [thing for thing in sure if view.is_itself(thing)]
            possible = tuple(thing for thing, how in related if how.verdict != FALSE)
            anchors, numbers = anchored, _deciding(seen, sure)
            found = {thing.object_id: dict(how.numbers) for thing, how in related}
        if not sure and possible:
            return Problem("condition_decided", f"surely a {phrase.label} or surely none", found)
        # That the one object of a label is elsewhere can be seen; that no such object exists must be known.
        definite = phrase.qualifier is not None and view.only(phrase.label) is not None
        if not sure and not definite and (doubt := self._doubt(view, phrase, anchors)) is not None:
            return Problem("absence_known", f"a room known to have no other {phrase.label}", doubt)
        if not sure and not anchors and not self._elsewhere(phrase.label, view):
            return Problem("absent_is_elsewhere", f"a {phrase.label} in another room", "none in the scene")
        witnesses = frozenset(thing.object_id for thing in sure)
        return Answer(bool(sure), definite, witnesses, view.room.room_id, _ids(anchors), room_anchor, numbers)

    # -- bearings ------------------------------------------------------------------------------------------------------

    def _here(self, start: Standpoint | None) -> RoomView | Problem:
        """Return the one room that contains the start; a problem if there is not exactly one."""
        around = [] if start is None else [view for view in self.rooms.values() if start.is_in(view.room)]
        if len(around) != 1:
            return Problem("bearing_room", "a start in one room", [view.room.room_id for view in around])
        return around[0]

    def _thing_at(self, phrase: Phrase, start: Standpoint | None) -> Referent | Problem:
        view = self._here(start)
        if isinstance(view, Problem):
            return view
        assert start is not None
        assert phrase.qualifier is not None
        if view.may_be_foreign(phrase.label):
            return _of_two_rooms(view, phrase.label)
        meant = view.meant(phrase.label)
        if len(meant) < 2:
            return Problem("qualifier_needed", f"several things like a {phrase.label}", len(meant))
        related = [(thing, start.judge(phrase.qualifier[0], thing, self._thresholds)) for thing in meant]
        chosen = _the_one(view, phrase, related)
        return chosen if isinstance(chosen, Problem) else Referent(chosen.object_id, view.room.room_id, (), None)

    def _claim_at(self, phrase: Phrase, start: Standpoint | None) -> Answer | Problem:
        room, here = self.room(phrase.room), self._here(start)
        if isinstance(room, Problem):
            return room
        if isinstance(here, Problem):
            return here
        view, room_anchor = room
        if view is not here:
            return Problem("bearing_room", here.room.room_id, view.room.room_id)
        assert start is not None
        assert phrase.qualifier is not None
        only = view.only(phrase.label)
        if only is None:
            return Problem("referent_unique", f"one {phrase.label}", [x.object_id for x in view.meant(phrase.label)])
        how = start.judge(phrase.qualifier[0], only, self._thresholds)
        if how.verdict not in (TRUE, FALSE):
            return Problem("condition_decided", f"surely {phrase.qualifier[0]} or surely not", dict(how.numbers))
        truth = how.verdict == TRUE
        witnesses = frozenset((only.object_id,) if truth else ())
        return Answer(truth, True, witnesses, view.room.room_id, (), room_anchor, how.numbers)

    def _doubt(self, view: RoomView, phrase: Phrase, anchors: Sequence[Thing]) -> str | None:
        """Return why the absence of the object named by `phrase` can't be known, or None if it can. The reason is the
        id of an incompletely annotated room, or of an object without or with another label that may be the one named.
        """
        if not view.is_complete or (view.has_always(phrase.label) and not view.meant(phrase.label)):
            return view.room.room_id
        if phrase.qualifier is None and (others := view.confused(phrase.label)):
            return others[0].object_id
        for thing in view.nameless(phrase.label):
            if phrase.qualifier is None or thing.box is None:
                return thing.object_id
            if self.judge(phrase.qualifier[0], thing, anchors, view.surroundings, asked=True).verdict != FALSE:
                return thing.object_id
        return None

    def _elsewhere(self, label: str, view: RoomView) -> bool:
        return self.single_room or any(label in other.labels for other in self.rooms.values() if other is not view)


def _deciding(related: list[tuple[Thing, Judgement]], sure: list[Thing]) -> Mapping[str, float | None]:
    """Return the measurements of the first witness in `sure`. If there is no witness, return the measurements of the
    first object in `related`.
    """
    for thing, how in related:
        if not sure or thing is sure[0]:
            return how.numbers
    return {}


def _the_one(view: RoomView, phrase: Phrase, related: Sequence[tuple[Thing, Judgement]]) -> Thing | Problem:
    """Return the one object that fits a phrase with a qualifier, by the judgements on all that it might mean; a problem
    if there is not exactly one, if it and another box may be the same real object, or if people may not recognise it by
    its name.
    """
    fitting = [thing for thing, how in related if how.verdict == TRUE and thing.label == phrase.label]
    open_ones = [thing.object_id for thing, how in related if how.verdict != FALSE]
    if len(fitting) != 1 or len(open_ones) != 1:
        return Problem("qualifier_sufficient", f"one {phrase}", open_ones)
    (thing,) = fitting
    if not view.is_clear(thing):
        return Problem("referent_clear", f"surely a {thing.label} of this room", thing.object_id)
    if not view.is_itself(thing):
        return Problem("referent_upright", f"a {thing.label} in its place", thing.object_id)
    other = view.double(thing)
    if other is not None:
        return Problem("referent_single", f"one box of one {thing.label}", sorted((thing.object_id, other.object_id)))
    return thing


def _of_two_rooms(view: RoomView, label: str) -> Problem:
    return Problem("referent_clear", f"no {label} between {view.room.room_id} and another room", sorted(view.foreign))


def _ids(things: Iterable[Thing]) -> tuple[str, ...]:
    return tuple(thing.object_id for thing in things)

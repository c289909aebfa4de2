"""What contains what, what rests on what, and what is hidden: by the source's word and by boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.labels import vocabulary
from condvln.scene import OrientedBox, SceneObject
from condvln.scene.containment import with_containment


def thing(
    name: str,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    *,
    label: str = "",
    receptacles: tuple[str, ...] | None = None,
    openness: float | None = None,
) -> SceneObject:
    box = np.array([low, high], dtype=np.float64)
    own = label or name
    return SceneObject(name, "r", own, own, box.mean(axis=0), aabb=box, receptacles=receptacles, openness=openness)


def facts(*objects: SceneObject, family: str = "procthor") -> dict[str, tuple[str | None, str | None, bool]]:
    return {o.object_id: (o.parent, o.support, o.hidden) for o in with_containment(objects, family)}


FRIDGE = ((0.0, 0.0, 0.0), (0.8, 1.8, 0.7))
EGG = ((0.3, 0.9, 0.3), (0.36, 0.96, 0.36))


@pytest.mark.parametrize(("openness", "hidden"), [(None, True), (0.0, True), (0.49, True), (0.5, False), (1.0, False)])
def test_a_shut_container_hides_what_is_inside(openness: float | None, hidden: bool) -> None:
    fridge = thing("refrigerator", *FRIDGE, openness=openness)
    for receptacles in (None, ("refrigerator",)):
        found = facts(replace(fridge, receptacles=None), thing("egg", *EGG, receptacles=receptacles))
        assert found == {"refrigerator": (None, None, False), "egg": ("refrigerator", None, hidden)}


def test_what_stands_on_top_is_supported() -> None:
    bowl = thing("bowl", (0.2, 1.8, 0.2), (0.5, 1.9, 0.5), receptacles=("refrigerator",))
    assert facts(thing("refrigerator", *FRIDGE), bowl)["bowl"] == (None, "refrigerator", False)
    measured = replace(bowl, receptacles=None)
    assert facts(thing("refrigerator", *FRIDGE), measured)["bowl"] == (None, "refrigerator", False)


@pytest.mark.parametrize("label", ["dining table", "shelf", "shelving unit", "desk", "television stand", "nightstand"])
def test_tables_and_shelves_support_and_never_hide(label: str) -> None:
    shelf = thing("holder", *FRIDGE, label=label)
    assert facts(shelf, thing("egg", *EGG, receptacles=("holder",)))["egg"] == (None, "holder", False)
    assert facts(shelf, thing("egg", *EGG))["egg"] == (None, None, False)


def test_hiding_reaches_what_is_on_and_in_what_is_hidden() -> None:
    plate = thing("plate", (0.2, 0.9, 0.2), (0.5, 0.92, 0.5), receptacles=("refrigerator",))
    bowl = thing("bowl", (0.25, 0.92, 0.25), (0.45, 1.0, 0.45), receptacles=("plate",))
    apple = thing("apple", (0.3, 0.93, 0.3), (0.36, 0.99, 0.36), receptacles=("bowl",))
    found = facts(apple, bowl, plate, thing("refrigerator", *FRIDGE))
    assert found["plate"] == ("refrigerator", None, True)
    assert found["bowl"] == (None, "plate", True)
    assert found["apple"] == ("bowl", None, True)


def test_a_scanner_saw_what_it_recorded() -> None:
    found = facts(thing("refrigerator", *FRIDGE), thing("egg", *EGG), family="gibson")
    assert found["egg"] == ("refrigerator", None, False)


def test_the_smaller_of_two_containers_holds() -> None:
    box = thing("box", (0.2, 0.8, 0.2), (0.5, 1.1, 0.5))
    found = facts(thing("refrigerator", *FRIDGE), box, thing("egg", *EGG))
    assert found["egg"][0] == "box"
    assert found["box"][0] == "refrigerator"


@pytest.mark.parametrize(("share", "inside"), [(0.79, False), (0.81, True)])
def test_four_fifths_of_a_box_must_lie_inside(share: float, inside: bool) -> None:
    egg = thing("egg", (0.8 - 0.1 * share, 0.5, 0.3), (0.9 - 0.1 * share, 0.6, 0.4))
    assert (facts(thing("refrigerator", *FRIDGE), egg)["egg"][0] is not None) == inside


def test_a_wrong_word_of_the_simulator_is_not_believed() -> None:
    """FloorPlan9 of iTHOR names a plate as receptacle of the counter below it."""
    counter = thing("counter", (0, 0, 0), (2, 0.9, 0.7), receptacles=("plate",))
    plate = thing("plate", (0.2, 0.9, 0.2), (0.4, 0.92, 0.4), receptacles=("counter",))
    assert facts(counter, plate) == {"counter": (None, None, False), "plate": (None, "counter", False)}
    ring = [
        thing(name, (0, y, 0), (1, y + 1, 1), label="bowl", receptacles=(below,))
        for name, below, y in (("a", "b", 0), ("b", "c", 2), ("c", "a", 4))
    ]
    supports = {name: support for name, (_, support, _) in facts(*ring).items()}
    assert sum(support is None for support in supports.values()) == 1


def test_nothing_rests_over_the_notch_of_a_counter() -> None:
    whole = thing("counter", (0, 0, 0), (2, 0.9, 2))
    arms = [((1, 0.45, 0.3), (1, 0.45, 0.3)), ((0.3, 0.45, 1), (0.3, 0.45, 1))]
    counter = replace(whole, parts=tuple(OrientedBox(np.array(c), np.array(h), np.eye(3)) for c, h in arms))
    over_notch = thing("bowl", (1.5, 0.9, 1.5), (1.7, 1, 1.7))
    over_arm = thing("plate", (1.5, 0.9, 0.2), (1.7, 0.92, 0.4))
    found = facts(counter, over_notch, over_arm)
    assert found["bowl"][1] is None
    assert found["plate"][1] == "counter"
    assert facts(whole, over_notch)["bowl"][1] == "counter"


def test_the_table_of_containers_names_canonical_labels_once() -> None:
    from importlib.resources import files

    rows = files("condvln.labels").joinpath("containers.csv").read_text(encoding="utf-8").splitlines()[1:]
    labels = [row.split(",")[0] for row in rows]
    assert labels == sorted(set(labels))
    assert set(labels) <= set(vocabulary.labels)
    for label in ("refrigerator", "base cabinet", "drawer", "microwave", "dresser"):
        assert vocabulary.container(label) == "shut"
    for label in ("sink", "trash can"):
        assert vocabulary.container(label) == "open"
    for label in ("table", "shelf", "television stand", "bed", "desk", "no such label"):
        assert vocabulary.container(label) is None


boxes = st.tuples(*[st.integers(0, 12)] * 3, *[st.integers(1, 8)] * 3)


@settings(max_examples=200)
@given(
    st.lists(
        st.tuples(
            boxes,
            st.sampled_from(["refrigerator", "box", "bowl", "table", "egg", "wall", "drawer"]),
            st.none() | st.lists(st.integers(0, 6), max_size=2),
            st.none() | st.floats(0, 1),
        ),
        max_size=7,
    ),
    st.randoms(use_true_random=False),
)
def test_links_form_no_cycle_and_do_not_depend_on_order(drawn: list, random) -> None:  # type: ignore[no-untyped-def, type-arg]
    objects = [
        thing(
            f"o{k}",
            tuple(0.1 * c for c in at[:3]),
            tuple(0.1 * (c + s) for c, s in zip(at[:3], at[3:], strict=True)),
            label=label,
            receptacles=None if said is None else tuple(f"o{n}" for n in said),
            openness=openness,
        )
        for k, (at, label, said, openness) in enumerate(drawn)
    ]
    found = facts(*objects)
    shuffled = list(objects)
    random.shuffle(shuffled)
    assert facts(*shuffled) == found
    shut = {o.object_id for o in objects if vocabulary.container(o.label) == "shut"}
    closed = {o.object_id for o in objects if o.object_id in shut and (o.openness is None or o.openness < 0.5)}
    for name, (parent, support, hidden) in found.items():
        above: set[str] = set()
        ahead = [name]
        while ahead:
            at = ahead.pop()
            for up in found[at][:2]:
                assert up != name
                if up is not None and up not in above:
                    above.add(up)
                    ahead.append(up)
        assert parent is None or parent != support
        inside = {found[at][0] for at in {name, *above}} - {None}
        assert hidden or not inside & closed

"""Rows give back the programs they were made from, and the scalars people filter by are true."""

from __future__ import annotations

from condvln.instructions import (
    instruction_id,
    instruction_table,
    instructions_with_text,
    program_key,
    programs_from_table,
)
from condvln.instructions.programs import composition, oddness
from schemas.tables import INSTRUCTIONS


def test_programs_survive_their_table(sampled) -> None:
    for scene, _, _, programs in sampled:
        named = [(instruction_id(scene.family, scene.scene_id, p), p) for p in programs]
        texts = {name: "Go to the sofa." for name, _ in named[::2]}
        table = instructions_with_text(instruction_table(scene.scene_id, named), texts, {})
        assert table.schema.equals(INSTRUCTIONS)
        assert programs_from_table(table) == named
        for (name, program), row in zip(named, table.to_pylist(), strict=True):
            assert row["scene_id"] == scene.scene_id
            assert (row["category"], row["depth"], row["chain"]) == (program.category, program.depth, program.chain)
            assert (row["composition"], row["oddness"]) == (composition(program), oddness(program))
            assert row["gold_leaf"] == program.gold_leaf()
            assert row["moves"] == len(program.leaves[program.gold_leaf()].moves)
            assert (row["n_conditions"], row["n_leaves"]) == (len(program.conditions), len(program.leaves))
            assert row["n_relational"] == sum(c.qualifier is not None for c in program.conditions)
            assert (row["text"], row["words"]) == (("Go to the sofa.", 4) if name in texts else (None, None))


def test_ids_name_content(sampled) -> None:
    scene, _, _, programs = sampled[0]
    ids = {instruction_id(scene.family, scene.scene_id, p) for p in programs}
    assert len(ids) == len(programs)
    assert all(len(name) == 20 and int(name, 16) >= 0 for name in ids)
    program = programs[0]
    assert program_key(program) == program_key(program.model_copy(deep=True))
    assert instruction_id("a", "b", program) != instruction_id("a", "c", program) != instruction_id("b", "c", program)
    turned = program.conditions[0].model_copy(update={"truth": not program.conditions[0].truth})
    other = program.model_copy(update={"conditions": (turned, *program.conditions[1:])})
    assert program_key(other) != program_key(program), "truths are part of a program"


def test_an_id_is_the_same_on_every_machine() -> None:
    from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, RoomRef

    room = RoomRef(room_id="r", label="kitchen")
    program = Program(
        category="simple",
        conditions=(Condition(label="sink", room=room, truth=True, witnesses=("s",)),),
        branches=SHAPES["simple"].branches,
        leaves=tuple(Leaf(moves=(ObjectRef(object_id=x, label=x, room=room),)) for x in ("stove", "table")),
    )
    assert instruction_id("made", "scene", program) == "2915e0b0433abe66367c"

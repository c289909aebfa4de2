"""The report of texts of ours and of others, and the files that they are read from."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from condvln.instructions import render
from condvln.instructions.programs import with_leads
from condvln.language import language_report, read_texts
from condvln.language.texts import InstructionText
from schemas.errors import FormatError, InputError, MissingFileError
from schemas.program import SHAPES, Program

SAID = ["Exit the bathroom and turn left.", "Walk past the bed. Stop.", "Go to the sofa north of the bed."]


def files(folder: Path) -> list[Path]:
    """The same texts as four benchmarks have them."""
    vlnce = folder / "val.json.gz"
    vlnce.write_bytes(
        gzip.compress(json.dumps({"episodes": [{"instruction": {"instruction_text": s}} for s in SAID]}).encode())
    )
    r2r = folder / "R2R_val.json"
    r2r.write_text(json.dumps([{"path_id": 1, "instructions": SAID[:2]}, {"path_id": 2, "instructions": SAID[2:]}]))
    rxr = folder / "rxr.jsonl.gz"
    rxr.write_bytes(gzip.compress("\n".join(json.dumps({"instruction": s, "language": "en"}) for s in SAID).encode()))
    navspace = folder / "navspace.json"
    navspace.write_text(json.dumps({"episodes": [{"instruction": {"instruction_text": s}} for s in SAID]}))
    return [vlnce, r2r, rxr, navspace]


def test_texts_of_other_benchmarks(tmp_path: Path) -> None:
    for path in files(tmp_path):
        assert [one.text for one in read_texts(path)] == SAID, path.name


def test_a_report_by_hand(tmp_path: Path) -> None:
    found = language_report(read_texts(files(tmp_path)[0]))
    assert found.lengths["all"].texts == 3
    assert found.lengths["all"].mean == (6 + 5 + 8) / 3
    assert found.lengths["all"].median == 6
    assert found.lengths["all"].most == 8
    assert found.lengths["all"].sentence == (6 + 4 + 1 + 8) / 4
    assert found.lengths["all"].long_sentences == 0
    assert found.piece == 19
    # exit the bathroom and turn left | walk past the bed stop | go to the sofa north of the bed
    assert found.variety["type/token"] == 15 / 19
    assert found.variety["distinct-2"] == 15 / 16
    assert (found.compass, found.egocentric, found.banned_texts) == (1 / 3, 1 / 3, 0)
    assert found.templates == 1.0
    assert found.lint is found.asked is None
    assert json.loads(json.dumps(found.document()))["lengths"]["all"]["texts"] == 3


def test_what_is_asked_by_hand(repository: Path) -> None:
    """Six texts over several rooms, all with leads. Of twelve relations, one is between fixed things: the wall cabinet
    near the stove. Without leads, every order to look is about another room.
    """
    examples = json.loads((repository / "tests/condvln/instructions/example_programs.json").read_text())
    led = [with_leads(Program.model_validate(example["program"])) for example in examples]

    def asked(programs: list[Program]) -> dict[str, float]:
        texts = [InstructionText(render(one, 0, str(k)), one.category, one) for k, one in enumerate(programs)]
        found = language_report(texts).asked
        assert found is not None
        return found

    assert asked(led) == {
        "several rooms": 5 / 6,
        "with a lead": 1.0,
        "looks from afar": 0.0,
        "fixed beside fixed": 0.0,
        "worth nothing": 0.0,
    }
    plain = [p.model_copy(update={"branches": SHAPES[p.category].branches}) for p in led]
    assert asked(plain) == asked(led) | {"with a lead": 0.0, "looks from afar": 1.0}
    pens = [
        p.model_copy(update={"conditions": [c.model_copy(update={"label": "pen"}) for c in p.conditions]}) for p in led
    ]
    assert asked(pens)["worth nothing"] > 0.3


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("none.json", "[]", FormatError),
        ("other.json", "[1]", FormatError),
        ("other.jsonl", '{"a": 1}', FormatError),
        ("cut.json.gz", "not gzip", FormatError),
        ("text.json", "{", FormatError),
    ],
)
def test_what_holds_no_instructions_is_refused(
    tmp_path: Path, name: str, content: str, error: type[InputError]
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(error):
        list(read_texts(tmp_path / name))


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.json"):
        with pytest.raises(MissingFileError):
            list(read_texts(path))
    with pytest.raises(FormatError, match="no texts"):
        language_report([])

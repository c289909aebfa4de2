"""Every family's made scenes, from files to scores: exports that lint clean, their twins, the ladder of agents."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from condvln.evaluation.split import split_tasks
from condvln.export.splits import SPLITS
from condvln.formats.json_entries import read_unpacked
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.samples import FAMILIES
from jobs.generate import run_generate
from jobs.oracle import oracle_split
from jobs.validate import validate_files
from tests.condvln.evaluation.test_ladder import check_ladder
from tests.jobs.conftest import made_config
from tests.jobs.test_oracle import differences
from tests.once import made_once
from tests.strict_loader import AnsrEpisode, RxRInstruction, load_split

pytestmark = pytest.mark.soak

SCENES = 4
PER_CATEGORY = 10


@pytest.fixture(scope="module", params=sorted(FAMILIES))
def family(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with ``data`` and ``export`` of one family."""

    def make(folder: Path) -> Path:
        config = made_config(folder, request.param, SCENES, seed=5, episodes=PER_CATEGORY)
        report = run_generate(config, inline=True, console=Console(quiet=True))
        assert report.document["counts"]["quarantined"] == 0, report.document["quarantined"]
        assert (folder / "export" / "export.json").exists(), report.lines
        return folder

    return made_once(tmp_path_factory, f"export of {request.param}", make)


def test_its_export_is_clean_and_stands_on_its_navmeshes(family: Path) -> None:
    report = validate_files(family / "export", (family / "data",), (family / "data" / "connectivity",))
    assert {finding.code for finding in report.findings} <= {"no-episodes"}  # few scenes do not fill every split
    assert report.navmeshes.checked
    assert report.navmeshes.lacking == {}


def test_strict_loaders_take_every_variant(family: Path) -> None:
    index = json.loads((family / "export" / "export.json").read_text())
    for split in SPLITS:
        folder = family / "export" / "{}" / split
        stock = load_split(Path(str(folder).format("vlnce")) / f"{split}.json.gz")
        assert len(stock) == index["episodes"][split]
        for variant in ("ansr", "oracle"):
            other = load_split(
                Path(str(folder).format(variant)) / f"{split}.json.gz", *([AnsrEpisode] if variant == "ansr" else [])
            )
            assert [e.episode_id for e in other] == [e.episode_id for e in stock]
        guides = load_split(Path(str(folder).format("rxr")) / f"{split}_guide.json.gz", instruction=RxRInstruction)
        assert [e.episode_id for e in guides] == [e.episode_id for e in stock]


def test_its_twin_differs_in_the_instruction_alone(family: Path, tmp_path: Path) -> None:
    for split in SPLITS:
        out = tmp_path / f"{split}.json.gz"
        oracle_split(family / "export", split, out=out)
        assert out.read_bytes() == (family / "export" / "oracle" / split / f"{split}.json.gz").read_bytes()
        before = json.loads(read_unpacked(family / "export" / "vlnce" / split / f"{split}.json.gz"))["episodes"]
        after = json.loads(read_unpacked(out))["episodes"]
        for one, twin in zip(before, after, strict=True):
            assert set(differences(one, twin)) <= {".instruction.instruction_text", ".instruction.instruction_tokens"}


def test_its_ladder_orders_itself(family: Path) -> None:
    tasks = [task for split in SPLITS for task in split_tasks(family / "export", split)]
    assert len(tasks) >= 40
    check_ladder(tasks, NavmeshFolder((family / "export", family / "data")))

"""Recipes: what may be shared of scans whose images may not, and the same images made again from it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from PIL import Image
from typer.testing import CliRunner

from condvln.samples import make_samples
from condvln.sources.family import FAMILIES
from condvln.trajectories.recipe import RECIPE_FILES, Recipe, refuse_unlicensed
from jobs.command import app
from jobs.trajectories import Request, make_trajectories
from schemas.errors import FormatError, MissingFileError, ProofError, UsageError
from tests.jobs.trajectories.made import TINY, content, proven, rows, to


def images(folder: Path) -> dict[str, str]:
    return {path: found for path, found in content(folder).items() if path.startswith("images/")}


@pytest.fixture(scope="module")
def recipe(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe of one direct walk and its twin."""
    folder = tmp_path_factory.mktemp("recipe")
    for name in RECIPE_FILES:
        shutil.copy(made / "recipe" / name, folder)
    walk = min((row for row in rows(made, "trajectories") if row["kind"] == "direct"), key=lambda row: row["n_frames"])
    for name, column in (("trajectories", "frames_of"), ("poses", "trajectory")):
        table = pq.read_table(folder / f"{name}.parquet")
        pq.write_table(table.filter(pc.equal(table[column], walk["trajectory"])), folder / f"{name}.parquet")
    return folder


def again(asked: Request, recipe: Path, out: Path, **changes: Any) -> Request:
    return to(asked, out, target="", recipe=recipe, **changes)


def test_a_recipe_gives_the_same_images(asked: Request, made: Path, recipe: Path, tmp_path: Path) -> None:
    # What a killed run of other layouts left behind.
    left = [
        tmp_path / "out" / name
        for name in (".lerobot.part/data/x", "navila/.annotations.json.part", ".poses.parquet.part")
    ]
    for path in (*left, tmp_path / "out" / ".condvln" / "kept"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    report = make_trajectories(again(asked, recipe, tmp_path / "out"))
    assert not [path for path in (tmp_path / "out").rglob("*") if ".part" in path.name]
    assert (tmp_path / "out" / ".condvln" / "kept").exists()
    found = images(tmp_path / "out")
    assert found
    assert found.items() <= images(made).items()
    assert set(found) == {row["image"] for row in rows(recipe, "poses")}
    assert (report.exit_code, report.document["images_of_the_recipe"]) == (0, len(found))
    for name in ("trajectories", "poses"):
        assert rows(tmp_path / "out", name) == rows(recipe, name)
    # Without images the hashes are the same.
    bare = again(asked, recipe, tmp_path / "bare", recipe_only=True)
    assert make_trajectories(to(bare, bare.out, plan=True)).document["plan"]["episodes"] == 1
    make_trajectories(bare)
    assert sorted(content(tmp_path / "bare")) == sorted(RECIPE_FILES)
    assert rows(tmp_path / "bare", "poses") == rows(recipe, "poses")


def test_images_unlike_the_recipe_are_counted(asked: Request, recipe: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    shutil.copytree(recipe, theirs)
    poses = rows(recipe, "poses")
    rewrite(theirs, "poses", lambda found: found[3].update(sha256="0" * 64))
    record = json.loads((recipe / "trajectories.json").read_bytes())
    record["libraries"]["pillow"] = "1.0"
    record["encoders"] = {"jpg": "simplejpeg 0.1", "png": record["encoders"]["png"]}
    (scene,) = {row["scene_id"] for row in poses}
    record["scene_files"][f"replicacad/{scene}"] = "0" * 64
    (theirs / "trajectories.json").write_text(json.dumps(record))
    report = make_trajectories(again(asked, theirs, tmp_path / "out", recipe_only=True))
    assert report.exit_code == ProofError.exit_code
    assert report.document["images_unlike_the_recipe"] == 1
    assert report.document["scenes_unlike_the_recipe"] == [f"replicacad/{scene}"]
    assert poses[3]["image"] in "\n".join(report.lines)
    assert "pillow 1.0 (here" in "\n".join(report.lines)
    assert [line for line in report.lines if line.startswith("simplejpeg 0.1 wrote the jpg files of the recipe")]
    assert not [line for line in report.lines if "the png files" in line]


@pytest.mark.soak
def test_images_of_another_encoder_are_compared_by_their_pixels(asked: Request, made: Path, tmp_path: Path) -> None:
    """A folder whose images Pillow wrote is proven; another frame's image is a fault."""
    out = tmp_path / "out"
    out.mkdir()
    record = json.loads((made / "trajectories.json").read_bytes())
    record["encoders"] = dict.fromkeys(("jpg", "png"), "Pillow 11.0")
    record |= {"layouts": ["streamvln"], "cameras": {"rgb": record["cameras"]["rgb"]}}
    poses = [row for row in rows(made, "poses") if row["camera"] == "rgb"]
    quality = record["config"]["jpeg_quality"]
    for row in poses:
        (out / row["image"]).parent.mkdir(parents=True, exist_ok=True)
        with Image.open(made / row["image"]) as image:
            image.save(out / row["image"], quality=quality)
        data = (out / row["image"]).read_bytes()
        row |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    for name in ("trajectories.parquet", "left_out.parquet", "annotations.json"):
        shutil.copy(made / name, out)
    schema = pq.read_schema(made / "poses.parquet")
    (out / "trajectories.json").write_text(json.dumps(record))
    pq.write_table(pa.Table.from_pylist(poses, schema=schema), out / "poses.parquet")
    report = proven(asked, out, render_every=40)
    assert report.document["faults"] == []
    assert report.document["rendered"] > 10
    # Two images that are rendered again, of one scene, are swapped.
    again = [row for row in poses if int(hashlib.sha256(row["image"].encode()).hexdigest(), 16) % 40 == 0]
    one, other = again[0], next(row for row in again if row["position"] != again[0]["position"])
    for here, data in ((one, (out / other["image"]).read_bytes()), (other, (out / one["image"]).read_bytes())):
        (out / here["image"]).write_bytes(data)
        here |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    pq.write_table(pa.Table.from_pylist(poses, schema=schema), out / "poses.parquet")
    found = proven(asked, out, render_every=40).document["faults"]
    assert {(fault["trajectory"], fault["what"]) for fault in found} == {
        (row["trajectory"], f"frame {row['frame']}, rgb: the pose shows another image") for row in (one, other)
    }


@pytest.mark.soak
def test_a_whole_folder_is_made_again_from_its_recipe(asked: Request, made: Path, tmp_path: Path) -> None:
    assert make_trajectories(again(asked, made / "recipe", tmp_path / "out")).exit_code == 0
    ours, theirs = content(tmp_path / "out"), content(made)
    assert ours.keys() == theirs.keys()
    assert [path for path in ours if ours[path] != theirs[path]] == []
    assert proven(asked, tmp_path / "out").document["faults"] == []


def test_a_recipe_alone_is_proven(asked: Request, made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "recipe", tmp_path / "recipe")
    record = json.loads((made / "trajectories.json").read_bytes())
    (tmp_path / "recipe" / "trajectories.json").write_text(json.dumps(record | {"images_written": False}))
    report = proven(asked, tmp_path / "recipe", render_every=300)
    assert report.document["faults"] == []
    assert report.document["rendered"] > 1


@pytest.mark.parametrize(
    "values",
    [{"goals": []}, {"goals": [None]}, {"actions": [0]}, {"executed": [9]}, {"start_position": {"x": None}}],
    ids=str,
)
def test_values_of_walks_that_cant_be_are_faults(
    values: dict[str, Any], asked: Request, recipe: Path, tmp_path: Path
) -> None:
    theirs = tmp_path / "theirs"
    shutil.copytree(recipe, theirs)
    record_with(images_written=False)(theirs)
    rewrite(theirs, "trajectories", lambda found: found[0].update(values))
    report = proven(asked, theirs, render_every=0)
    name = rows(theirs, "trajectories")[0]["trajectory"]
    assert report.exit_code == 3
    assert any(fault["trajectory"] == name for fault in report.as_json()["faults"])


def test_images_of_licensed_scans_are_refused(asked: Request, recipe: Path, tmp_path: Path) -> None:
    assert {name for name, family in FAMILIES.items() if family.licensed} == {"gibson", "hm3d", "mp3d"}
    with pytest.raises(UsageError, match=r"Gibson and 3D Scene Graph and Matterport3D.*--licensed"):
        refuse_unlicensed(["procthor", "mp3d", "gibson"])
    refuse_unlicensed(["procthor", "unheard-of"])
    scan = tmp_path / "scan"
    shutil.copytree(recipe, scan)
    for name in ("trajectories", "poses", "left_out"):
        table = pq.read_table(recipe / f"{name}.parquet")
        sources = pa.array(["gibson"] * table.num_rows, pa.string())
        field = table.schema.field("source")
        pq.write_table(
            table.set_column(table.schema.get_field_index("source"), field, sources), scan / f"{name}.parquet"
        )
    make_samples(tmp_path / "gibson", family="gibson", scenes=1, seed=1)
    request = again(asked, scan, tmp_path / "out", scenes=(f"gibson={tmp_path / 'gibson'}",))
    with pytest.raises(UsageError, match="--licensed"):
        make_trajectories(request)
    assert not (tmp_path / "out").exists()
    # With the flag, and for a recipe, only the scene is missing.
    for changes in ({"licensed": True}, {"recipe_only": True}):
        assert make_trajectories(to(request, tmp_path / f"{[*changes]}", **changes)).document["counts"]["quarantined"]


def test_the_folder_says_its_terms(made: Path) -> None:
    text = (made / "README.md").read_text()
    record = json.loads((made / "trajectories.json").read_bytes())
    assert record["licences"]["replicacad"]["terms"] == FAMILIES["replicacad"].terms
    assert record["licences"]["replicacad"]["images_may_be_shared"]
    assert FAMILIES["replicacad"].credit in text
    assert sorted(path.name for path in (made / "recipe").iterdir()) == sorted(RECIPE_FILES)
    assert (made / "recipe" / "poses.parquet").samefile(made / "poses.parquet")


def rewrite(folder: Path, table: str, change: Callable[[list[dict[str, Any]]], object]) -> None:
    found = rows(folder, table)
    change(found)
    schema = pq.read_schema(folder / f"{table}.parquet")
    pq.write_table(pa.Table.from_pylist(found, schema=schema), folder / f"{table}.parquet")


def every(found: list[dict[str, Any]], **values: Any) -> None:
    for row in found:
        row.update(values)


def record_with(**values: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "trajectories.json"
        path.write_text(json.dumps(json.loads(path.read_bytes()) | values))

    return change


HOSTILE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a walk outside": (
        lambda f: [
            rewrite(f, "trajectories", lambda found: every(found, trajectory="../../out", frames_of="../../out")),
            rewrite(f, "poses", lambda found: every(found, trajectory="../../out")),
        ],
        "have different walks|not the name of a walk",
    ),
    "an image outside": (
        lambda f: rewrite(f, "poses", lambda found: found[0].update(image="../../x.jpg")),
        "is not the path of frame",
    ),
    "a camera outside": (record_with(cameras={"../rgb": TINY.model_dump()}), "not a record of trajectories"),
    "no main camera": (record_with(cameras={"rgb.x": TINY.model_dump()}), "the camera 'rgb' is missing"),
    "a split outside": (record_with(split="../../x"), "not a record of trajectories"),
    "a frame twice": (lambda f: rewrite(f, "poses", lambda found: found.append(dict(found[0]))), "has no pose"),
    "a frame lost": (lambda f: rewrite(f, "poses", lambda found: found.pop()), "has no pose"),
    "no number": (
        lambda f: rewrite(f, "poses", lambda found: every(found, heading=float("nan"))),
        "have different poses, or none",
    ),
    "an action": (lambda f: rewrite(f, "poses", lambda found: every(found, executed=7)), "has another action"),
    "a table cut": (lambda f: (f / "poses.parquet").write_bytes(b"PAR1"), "not a table of trajectories"),
    "a record cut": (lambda f: (f / "trajectories.json").write_bytes(b"{"), "not a record of trajectories"),
    "no tables": (lambda f: (f / "trajectories.parquet").unlink(), "trajectories.parquet is missing"),
    "nothing": (lambda f: (f / "trajectories.json").unlink(), "holds no recipe"),
}


@pytest.mark.parametrize("fault", HOSTILE)
def test_a_hostile_recipe_is_refused(fault: str, recipe: Path, tmp_path: Path) -> None:
    change, words = HOSTILE[fault]
    theirs = tmp_path / "theirs"
    shutil.copytree(recipe, theirs)
    change(theirs)
    with pytest.raises((FormatError, MissingFileError), match=words):
        read_all(theirs)


def read_all(folder: Path) -> None:
    recipe = Recipe(folder)
    for family, scene in recipe.scenes:
        recipe.tables(family, scene)


@pytest.mark.parametrize(
    "given",
    [
        "--camera=streamvln",
        "--layout=navila",
        "--sweep=height=1",
        "--walks=direct",
        "--walk=seed=0",
        "--recipe-only",
    ],
)
def test_what_the_recipe_decides_is_refused_on_the_command_line(given: str, tmp_path: Path) -> None:
    """Also where the option repeats the default, which the recipe may contradict."""
    command = ["trajectories", "--from-recipe", str(tmp_path), "--out", str(tmp_path / "out"), given]
    found = CliRunner().invoke(app, command)
    assert isinstance(found.exception, UsageError)
    assert f"Leave out {given.split('=')[0]}." in str(found.exception)
    assert not (tmp_path / "out").exists()

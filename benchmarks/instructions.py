"""Instructions per second and core: sampling, wording, and reading each text back as its proof.

On ProcTHOR houses where they are at hand (``CONDVLN_REAL_DATA``, or ``shared/data`` beside the checkout), else on made
houses of the same size. Processor time counts, so that other work on the machine does not. Facts are made before;
what a scene's sampler prepares is inside.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from condvln.instructions import (
    LabelPriors,
    ProgramSampler,
    apart_by_centres,
    instruction_id,
    parse,
    reading_of,
    render,
)
from condvln.instructions.degeneracy import degeneracies
from condvln.instructions.parsing import parser
from condvln.labels import vocabulary
from condvln.relations import relate_scene, text_facts
from condvln.scene import Room, Scene, SceneObject, round_mm
from condvln.sources.registry import open_source
from schemas.config import InstructionsConfig, PlacesConfig, SamplingConfig, Thresholds
from schemas.program import CATEGORIES

T = Thresholds()

SCENES = 12
WANTED = InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 10))
SAMPLING = SamplingConfig(candidates_per_episode=5)

ROOMS = {
    "kitchen": "refrigerator,sink,stove,microwave,table,chair,stool,trash can,plate,mug,toaster,kettle,bowl,knife,pan",
    "living room": "sofa,television,coffee table,armchair,lamp,plant,picture,rug,book,desk,shelf,laptop,vase,pillow",
    "bedroom": "bed,nightstand,lamp,wardrobe,desk,chair,pillow,picture,dresser,laptop,box,book,mirror,rug",
    "bathroom": "toilet,sink,bathtub,mirror,towel,trash can,cabinet,plant,toilet paper roll,soap bottle",
}


def made_house(seed: int) -> Scene:
    """A house of four rooms with random boxes of typical labels."""
    rng = np.random.default_rng(seed)
    rooms, objects = [], []
    for k, (label, names) in enumerate(ROOMS.items()):
        rooms.append(Room(f"r{k}", label, label, 0, 0.0, 2.5, None, "dataset", True))
        for j, name in enumerate(rng.choice(names.split(","), size=22)):
            size = rng.uniform(0.1, 1.2, 3)
            centre = np.array([7.0 * k, 0.0, 0.0]) + rng.uniform(0.0, 6.0, 3) * [1.0, 0.25, 1.0]
            box = round_mm(np.array([centre - size / 2, centre + size / 2]))
            objects.append(SceneObject(f"o{k}_{j:02}", f"r{k}", name, str(name), round_mm(box.mean(axis=0)), aabb=box))
    return Scene("made", f"house_{seed}", Path(), tuple(rooms), tuple(objects))


def houses() -> tuple[str, list[Scene]]:
    """Return the scenes to measure, and a name for them."""
    shared = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CONDVLN_REAL_DATA", shared)) / "procthor"
    if not folder.is_dir():
        return "made houses", [made_house(seed) for seed in range(SCENES)]
    source = open_source("procthor", folder)
    return "ProcTHOR houses", [source.read(handle.scene_id) for handle in list(source.handles())[:SCENES]]


def main() -> None:
    """Print the rates."""
    name, scenes = houses()
    facts = [{room: text_facts(relations, T) for room, relations in relate_scene(scene, T).items()} for scene in scenes]
    start = time.process_time()
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, SAMPLING.anchor_size) for scene in scenes)
    seconds = {"priors": time.process_time() - start}
    parser()

    start = time.process_time()
    drawn = []
    for scene, known in zip(scenes, facts, strict=True):
        sampler = ProgramSampler(
            scene,
            known,
            priors.bits(scene, SAMPLING.plausible_share),
            WANTED,
            SAMPLING,
            seed=0,
            stops=apart_by_centres(scene, PlacesConfig()),
            preamble=True,
        )
        for category in CATEGORIES:
            for program in sampler.candidates(category):
                drawn.append((instruction_id(scene.family, scene.scene_id, program), program))
    seconds["sampling"] = time.process_time() - start

    start = time.process_time()
    texts = [render(program, 0, key) for key, program in drawn]
    seconds["wording"] = time.process_time() - start

    start = time.process_time()
    for (_, program), text in zip(drawn, texts, strict=True):
        if degeneracies(program, vocabulary) or parse(text) != reading_of(program):
            raise AssertionError(f"not proven: {text}")
    seconds["proof"] = time.process_time() - start

    rooms, objects = sum(len(s.rooms) for s in scenes), sum(len(s.objects) for s in scenes)
    print(f"{len(drawn)} instructions on {len(scenes)} {name} ({rooms} rooms, {objects} objects)")
    print(f"priors    {rooms / seconds['priors']:8.0f} rooms/s")
    for part in ("sampling", "wording", "proof"):
        print(f"{part:9s} {len(drawn) / seconds[part]:8.0f} instructions/s")
    whole = sum(seconds[part] for part in ("sampling", "wording", "proof"))
    print(f"proven    {len(drawn) / whole:8.0f} instructions/s in total")


if __name__ == "__main__":
    main()

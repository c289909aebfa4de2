"""Relation graphs of many scenes with your own Ray tasks: ``python examples/ray_job.py FAMILY ROOT [ADDRESS]``.

``condvln generate`` does all of this with a store, retries and a published snapshot. This is for experiments of one's
own: a task a scene, plain Python in and out.
"""

from __future__ import annotations

import sys
from collections import Counter

import ray

import condvln as cv


@ray.remote
def predicates(family: str, root: str, scene_id: str) -> Counter[str]:
    """Count how often each predicate holds in a scene."""
    world = cv.open_world(cv.open_source(family, root), scene_id)
    return Counter(edge["predicate"] for _, _, edge in world.relation_graph().edges(data=True))


def main(family: str, root: str, address: str = "local") -> Counter[str]:
    """Print the counts over all scenes of a source."""
    ray.init(address=address, include_dashboard=False)
    tasks = [predicates.remote(family, root, name) for name in cv.open_source(family, root).scene_ids()]
    total: Counter[str] = Counter()
    while tasks:
        (done,), tasks = ray.wait(tasks)
        total += ray.get(done)
    ray.shutdown()
    return total


if __name__ == "__main__":
    for predicate, count in main(*sys.argv[1:]).most_common():
        print(f"{count:8} {predicate}")

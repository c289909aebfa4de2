"""Your own agent on an exported split, without a simulator: ``python examples/own_agent.py EXPORT SPLIT``.

The agent turns towards a random side whenever it bumps into something and stops after 60 steps. Put a model in ``act``.
"""

from __future__ import annotations

import random
import sys

import condvln as cv

STOP, FORWARD, LEFT, RIGHT = range(4)


class Wanderer:
    """An agent that keeps no state between episodes."""

    def begin(self, observation: cv.Observation) -> None:
        """Begin an episode. Read ``observation.instruction`` here."""
        self.random = random.Random(observation.episode_id)
        self.turns: list[int] = []

    def act(self, observation: cv.Observation) -> int:
        """Return one of VLN-CE's four actions."""
        if observation.step >= 60:
            return STOP
        if observation.collided and not self.turns:
            self.turns = [self.random.choice((LEFT, RIGHT))] * self.random.randint(2, 8)
        return self.turns.pop() if self.turns else FORWARD


def main(folder: str, split: str, *roots: str) -> None:
    """Walk a split and print mean scores. ``roots`` are the folders of the datasets, which hold their navmeshes."""
    export = cv.open_export(folder, roots)
    predictions = export.run(split, Wanderer())
    cv.write_predictions("wanderer.json", predictions)  # condvln evaluate reads it too
    means = export.evaluate(split, predictions, agent="wanderer").means
    for name in ("success", "oracle_success", "spl", "ndtw", "bsa_all", "csr_all", "leaf_correct", "wrong_branch"):
        print(f"{name:16}{means[name]:7.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])

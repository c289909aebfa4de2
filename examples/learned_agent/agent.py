"""The trained network as an agent of ``condvln walk``; see README.md. Two environment variables name what it loads:

LEARNED_AGENT       the checkpoint that train.py wrote
LEARNED_AGENT_EYES  EXPORT=DATASET: where the text sensor finds the scenes of the episodes (several: with a comma)
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))

from network import Policy, Words, frame_batch, frame_tensors, text_batch
from seen import START, Memory, Text
from space import scan

import condvln as cv
from condvln.evaluation.scene_views import SceneViews
from condvln.manifest import manifest_paths
from condvln.sensors import TextSensor

STOP, FORWARD = 0, 1
PATIENCE = 200
"""Steps after which the agent stops where it is."""
TEMPERATURE = float(os.environ.get("LEARNED_AGENT_TEMPERATURE", "0.5"))


class Agent:
    """Sees the text sensor's words, remembers things, and draws actions from the network's odds."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        kept = torch.load(os.environ["LEARNED_AGENT"], weights_only=True)
        self._words = Words(kept["words"])
        self._policy = Policy(self._words).eval()
        self._policy.load_state_dict(kept["policy"])
        self._scenes: dict[str, tuple[SceneViews, str]] = {}
        for pair in os.environ["LEARNED_AGENT_EYES"].split(","):
            folder, _, dataset = pair.partition("=")
            episodes = [one for path in manifest_paths(Path(folder)) for one in cv.read_manifest(path)]
            views = SceneViews({one.source: dataset for one in episodes})
            self._scenes |= {str(one.episode_id): (views, f"{one.source}/{one.scene_id}") for one in episodes}

    def begin(self, observation: cv.Observation) -> None:
        """Read the instruction, and forget the last episode."""
        views, scene = self._scenes[observation.episode_id]
        view = views(scene)
        self._sensor, self._renderer = TextSensor(view.scene, view.renderer), view.renderer
        self._last, self._state = START, None
        text = Text.of(observation.instruction)
        self._memory = Memory(text)
        self._draws = torch.Generator().manual_seed(int(observation.episode_id) % 2**31)
        with torch.no_grad():
            self._read = self._policy.read(text_batch([text], self._words))

    def act(self, observation: cv.Observation) -> int:
        """Return the next action."""
        if observation.step >= PATIENCE:
            return STOP
        place, heading = observation.position, observation.heading
        seen = self._sensor.observe(place, heading)
        scanned = scan(self._renderer, place, heading)
        frame = self._memory.see(seen, scanned, place, heading, observation.collided, self._last)
        with torch.no_grad():
            logits, self._state = self._policy(self._read, frame_batch([frame_tensors([frame])]), self._state)
        odds = (logits[0, 0] / TEMPERATURE).softmax(0)
        self._last = int(torch.multinomial(odds, 1, generator=self._draws))
        return self._last

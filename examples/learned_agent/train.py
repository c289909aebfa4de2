"""Imitate recorded walks: ``python train.py WALKS --out FOLDER``; started again, it goes on where it was."""

from __future__ import annotations

import argparse
import json
import random
import time
from pathlib import Path

import torch
from network import Policy, Words, frame_batch, text_batch
from seen import Text
from torch import Tensor, nn

BATCH = 4
"""Few walks, for many updates: with 24 the same epochs leave the network far from done."""
STOP_WEIGHT = 3.0
"""A walk has one STOP among a hundred actions."""


def losses(policy: Policy, walks: list[dict], texts: dict[str, Text], words: Words) -> tuple[Tensor, Tensor]:
    """Return the mean loss over the frames to imitate, and the share of them with the right action."""
    read = policy.read(text_batch([texts[walk["text"]] for walk in walks], words))
    logits, _ = policy(read, frame_batch(walks))
    pad = nn.utils.rnn.pad_sequence
    actions = pad([walk["actions"].long() for walk in walks], batch_first=True)
    right = pad([walk["right"] for walk in walks], batch_first=True)
    weight = torch.tensor([STOP_WEIGHT, 1.0, 1.0, 1.0])
    loss = nn.functional.cross_entropy(logits[right], actions[right], weight)
    return loss, (logits.argmax(2) == actions)[right].float().mean()


def batches(walks: list[dict], seed: int) -> list[list[dict]]:
    """Return batches of walks of about the same length, in an order of the seed."""
    order = random.Random(seed)
    long = sorted(walks, key=lambda walk: len(walk["actions"]) + order.random() * 30)
    found = [long[k : k + BATCH] for k in range(0, len(long), BATCH)]
    order.shuffle(found)
    return found


def main() -> None:
    """Train one network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("walks", type=Path, nargs="+", help="files that record.py wrote")
    parser.add_argument("--held-out", type=Path, nargs="*", default=(), help="walks of other houses")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--until", type=int, help="epoch after which to stop for now; a later call goes on")
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    walks = [walk for path in arguments.walks for walk in torch.load(path, weights_only=True)]
    held_out = [walk for path in arguments.held_out for walk in torch.load(path, weights_only=True)]
    texts = {walk["text"]: Text.of(walk["text"]) for walk in (*walks, *held_out)}
    words = Words.of(walk["text"] for walk in walks)
    policy = Policy(words)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=arguments.rate, weight_decay=0.01)
    steps = arguments.epochs * len(batches(walks, 0))
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, arguments.rate, total_steps=steps, pct_start=0.1)
    checkpoint = arguments.out / "checkpoint.pt"
    log: list[dict[str, float]] = []
    if checkpoint.is_file():
        kept = torch.load(checkpoint, weights_only=True)
        if kept["schedule"]["total_steps"] != steps:
            raise SystemExit(f"{checkpoint} is of a training of another length: name its --epochs and walks")
        policy.load_state_dict(kept["policy"])
        optimizer.load_state_dict(kept["optimizer"])
        schedule.load_state_dict(kept["schedule"])
        torch.set_rng_state(kept["random"])
        log = kept["log"]
        print(f"goes on after epoch {len(log)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for epoch in range(len(log), min(arguments.epochs, arguments.until or arguments.epochs)):
        policy.train()
        began, sums = time.time(), torch.zeros(2)
        parts = batches(walks, 1000 * arguments.seed + epoch)
        for batch in parts:
            loss, hits = losses(policy, batch, texts, words)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            sums += torch.stack([loss.detach(), hits])
        row = {"epoch": epoch + 1, "loss": sums[0].item() / len(parts), "hits": sums[1].item() / len(parts)}
        if held_out:
            policy.eval()
            with torch.no_grad():
                found = [torch.stack(losses(policy, batch, texts, words)) for batch in batches(held_out, 0)]
            row["held_out_loss"], row["held_out_hits"] = torch.stack(found).mean(0).tolist()
        row["seconds"] = time.time() - began
        log.append(row)
        print(json.dumps({name: round(value, 4) for name, value in row.items()}), flush=True)
        state = {
            "policy": policy.state_dict(),
            "optimizer": optimizer.state_dict(),
            "schedule": schedule.state_dict(),
            "random": torch.get_rng_state(),
            "words": words.words[2:],
            "log": log,
        }
        torch.save(state, checkpoint.with_suffix(".part"))
        checkpoint.with_suffix(".part").replace(checkpoint)
    (arguments.out / "log.json").write_text(json.dumps(log, indent=1))


if __name__ == "__main__":
    main()

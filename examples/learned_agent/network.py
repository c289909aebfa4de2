"""A small policy over things seen and the words that name them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from seen import FEATURES, LABELS, NOUNS, OWN, ROOMS, START, Frame, Text, words_of
from torch import Tensor, nn
from torch.nn import functional

UNKNOWN = 1


class Words:
    """The words of the training texts and of all labels; the others are one word."""

    def __init__(self, words: Iterable[str]) -> None:
        self.words = ["", "<unknown>", *words]
        self.number = {word: k for k, word in enumerate(self.words)}

    @classmethod
    def of(cls, texts: Iterable[str]) -> Words:
        """Collect the words of texts."""
        return cls(sorted({word for text in texts for word in words_of(text)}))

    def numbers(self, text: Text) -> Tensor:
        """Return the numbers of a text's words."""
        return torch.tensor([self.number.get(word, UNKNOWN) for word in text.words])


def text_batch(texts: list[Text], words: Words) -> dict[str, Tensor]:
    """Return texts as padded tensors (b, w)."""
    columns = {
        "word": [words.numbers(text) for text in texts],
        "word_label": [torch.tensor(text.label) for text in texts],
        "word_room": [torch.tensor(text.room) for text in texts],
    }
    return {name: nn.utils.rnn.pad_sequence(rows, batch_first=True) for name, rows in columns.items()}


class Recall(nn.Module):
    """Attention of each frame to itself and the frames before it; a head looks less far back the steeper its slope."""

    def __init__(self, size: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.first, self.second = nn.LayerNorm(size), nn.LayerNorm(size)
        self.ask, self.answer = nn.Linear(size, 3 * size), nn.Linear(size, size)
        self.mix = nn.Sequential(nn.Linear(size, size), nn.ReLU(), nn.Linear(size, size))
        self.register_buffer("slopes", torch.tensor([0.0, 0.03, 0.2, 1.0])[:, None, None], persistent=False)

    def forward(self, x: Tensor, past: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the frames (b, t, size) with what they recall, and the keys and values of all frames so far."""
        b, t, size = x.shape
        asked = self.ask(self.first(x)).view(b, t, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        past = asked[1:] if past is None else torch.cat([past, asked[1:]], 3)
        steps = torch.arange(past.shape[3])
        ago = steps[-t:, None] - steps
        bias = torch.where(ago < 0, -1e4, -self.slopes * ago)
        found = functional.scaled_dot_product_attention(asked[0], past[0], past[1], bias)
        x = x + self.answer(found.transpose(1, 2).reshape(b, t, size))
        return x + self.mix(self.second(x)), past


class Policy(nn.Module):
    """Instruction and frames → actions.

    What a thing means is the sum of the encodings of those words of the text that name it, of the words that name its
    room, and of the embeddings of its label's words: a label that training never saw still points at its clause.
    """

    def __init__(self, words: Words, size: int = 48, state: int = 128, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.embedding = nn.Embedding(len(words.words), size, padding_idx=0)
        self.encoder = nn.GRU(size, size // 2, batch_first=True, bidirectional=True)
        spelled = torch.zeros(len(LABELS), len(words.words))
        for number, noun in enumerate(NOUNS):
            for word in words_of(noun):
                spelled[number, words.number.get(word, UNKNOWN)] += 1
        self.register_buffer("spelled", spelled / spelled.sum(1, keepdim=True).clamp(min=1), persistent=False)
        self.kind = nn.Embedding(4, size)
        self.of_label, self.of_room = nn.Linear(2 * size, size), nn.Linear(size, size)
        self.of_features = nn.Linear(FEATURES, size)
        self.thing = nn.Sequential(nn.ReLU(), nn.Linear(size, size), nn.ReLU())
        self.pick = nn.Linear(size, heads)
        self.room = nn.Embedding(len(ROOMS), 16)
        self.last = nn.Embedding(START + 1, 16)
        self.around = nn.Sequential(nn.Linear(OWN, 64), nn.ReLU())
        self.enter = nn.Linear((1 + heads) * size + 2 * size + 16 + 16 + 64, state)
        self.memory = Recall(state)
        self.ask_words = nn.Linear(state, size)
        self.ask_things = nn.Linear(state + size, heads * size)
        found = heads * (size + FEATURES)
        self.act = nn.Sequential(
            nn.Linear(state + size + found + 64, state), nn.ReLU(), nn.Dropout(0.1), nn.Linear(state, 4)
        )
        self.drop = nn.Dropout(0.1)

    def read(self, text: dict[str, Tensor]) -> dict[str, Tensor]:
        """Encode texts (b, w): their words, and what each label and each room means in them."""
        lengths = (text["word"] > 0).sum(1).cpu()
        packed = nn.utils.rnn.pack_padded_sequence(
            self.drop(self.embedding(text["word"])), lengths, batch_first=True, enforce_sorted=False
        )
        words = nn.utils.rnn.pad_packed_sequence(self.encoder(packed)[0], batch_first=True)[0]
        count, _, size = words.shape
        label, room = words.new_zeros(count, len(LABELS), size), words.new_zeros(count, len(ROOMS), size)
        label = label.scatter_add(1, text["word_label"][..., None].expand_as(words), words)
        room = room.scatter_add(1, text["word_room"][..., None].expand_as(words), words)
        label = torch.cat([label[:, :1] * 0, label[:, 1:]], 1)
        room = torch.cat([room[:, :1] * 0, room[:, 1:]], 1)
        own = self.spelled @ self.embedding.weight + self.kind.weight[[0, 1, 2, 3] + [0] * (len(LABELS) - 4)]
        whole = torch.cat([words.amax(1), words[torch.arange(count), lengths - 1]], 1)
        return {
            "words": words,
            "mask": text["word"] > 0,
            "label": self.of_label(torch.cat([label, own.expand_as(label)], 2)),
            "room": self.of_room(room),
            "here": room,
            "whole": whole,
        }

    def forward(
        self, read: dict[str, Tensor], frames: dict[str, Tensor], state: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the logits (b, t, 4) of frames (b, t, …), and the state after them."""
        b, t, _ = frames["label"].shape
        batch = torch.arange(b)[:, None, None]
        mask = frames["label"] > 0
        thing = self.thing(
            read["label"][batch, frames["label"]]
            + read["room"][batch, frames["room"]]
            + self.of_features(frames["features"])
        )
        closed = torch.where(mask, 0.0, -1e4)
        share = (self.pick(thing) + closed[..., None]).softmax(2)
        picked = torch.einsum("btnh,btnd->bthd", share, thing).flatten(2)
        most = (thing + closed[..., None]).amax(2)
        here = read["here"][torch.arange(b)[:, None], frames["place"][..., 0]]
        last = frames["place"][..., 1]
        if self.training:
            # A network that sees the last action learns to repeat it, so half of the frames hide it.
            last = torch.where(torch.rand(last.shape) < 0.5, torch.full_like(last, START), last)
        around = self.around(frames["own"])
        entered = torch.cat([picked, most, here, self.room(frames["place"][..., 0]), self.last(last), around], 2)
        text = read["whole"][:, None, : thing.shape[-1]].expand(-1, t, -1)
        out, state = self.memory(functional.relu(self.enter(torch.cat([entered, text], 2))), state)
        out = self.drop(out)
        words = self.ask_words(out) @ read["words"].transpose(1, 2) / read["words"].shape[-1] ** 0.5
        words = words.masked_fill(~read["mask"][:, None], -1e4).softmax(2) @ read["words"]
        asked = self.ask_things(torch.cat([out, words], 2)).view(b, t, self.heads, -1)
        share = torch.einsum("bthd,btnd->bthn", asked, thing) / thing.shape[-1] ** 0.5
        share = (share + closed[:, :, None]).softmax(3)
        found = torch.einsum("bthn,btnd->bthd", share, torch.cat([thing, frames["features"]], 3)).flatten(2)
        return self.act(torch.cat([out, words, found, around], 2)), state


def frame_tensors(frames: list[Frame]) -> dict[str, Tensor]:
    """Return the frames of a walk as tensors (t, …) of few bytes."""
    kinds = {"label": np.int16, "room": np.int8, "features": np.float16, "own": np.float16, "place": np.int8}
    columns = {name: np.stack([getattr(frame, name) for frame in frames]) for name in kinds}
    return {name: torch.from_numpy(column.astype(kinds[name])) for name, column in columns.items()}


def frame_batch(walks: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Return the frames of walks as padded tensors (b, t, …)."""

    def padded(name: str, kind: torch.dtype) -> Tensor:
        return nn.utils.rnn.pad_sequence([walk[name].to(kind) for walk in walks], batch_first=True)

    whole = {name: padded(name, torch.long) for name in ("label", "room", "place")}
    return whole | {name: padded(name, torch.float32) for name in ("features", "own")}

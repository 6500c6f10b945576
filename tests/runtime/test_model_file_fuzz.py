"""Hostile model files of every kind: an error of the family, or a model that keeps the contract."""

import copy
import hashlib
import json
import math
from collections.abc import Iterator

import numpy as np
import pytest

from runtime import Contract, SSDNetError
from runtime.contract import MAX_PIXELS

HOSTILE = [
    None, True, 0, -1, 1.5, 1e39, 1e-320, 2**63, 2**1024, float("nan"), float("inf"), 20_000, "",
    "\0", "\n", "\ud800", "\U0010ffff", "x" * 100_000, "__proto__", [], {}, [[]] * 3,
    [20_000, 20_000], [-1, 64], [1e308, 1e308], {"name": "\udfff", "color": [0, 0, 0]},
    [{"name": "road", "color": [0, 0, 0]}] * 300,
]  # fmt: skip


def places(value: object, path: tuple = ()) -> Iterator[tuple]:
    """The path of every value inside a document."""
    if path:
        yield path
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items if isinstance(value, dict | list) else ():
        yield from places(inner, (*path, key)) if isinstance(inner, dict | list) else [(*path, key)]


def sealed(body: str) -> str:
    """The text of a document with its digest: an older one would refuse every change."""
    digest = hashlib.sha256(body.encode()).hexdigest()
    return f'{body}, "document_sha256": "{digest}"}}'


def mutated(document: dict, random: np.random.Generator) -> dict:
    """The document with one to three of its values replaced, or their keys renamed or left out."""
    document = copy.deepcopy(document)
    for _ in range(random.integers(1, 4)):
        paths = list(places(document))
        if not paths:
            break
        *way, key = paths[random.integers(len(paths))]
        holder = document
        for step in way:
            holder = holder[step]
        action = random.integers(6)
        if action == 0:
            del holder[key]
        elif action == 1 and isinstance(holder, dict):
            holder[str(key) + "\ud800"] = holder.pop(key)
        else:
            holder[key] = copy.deepcopy(HOSTILE[random.integers(len(HOSTILE))])
    return document


@pytest.mark.parametrize("seed", range(2))
def test_any_document_is_refused_or_sane(contract, seed):
    random = np.random.default_rng(seed)
    document = json.loads(contract.to_json()) | {"trained_height": 375}
    del document["document_sha256"]
    accepted = 0
    for _ in range(1500):
        text = sealed(json.dumps(mutated(document, random)).removesuffix("}"))
        try:
            read = Contract.from_json(text)
        except SSDNetError:
            continue
        accepted += 1
        read.to_json().encode()
        assert math.prod(read.native_size) <= MAX_PIXELS
        assert 0 < np.float32(read.max_depth_m) < math.inf
        assert np.float32(1) / np.float32(read.max_depth_m) > 0
        for info in read.classes:
            info.name.encode()
    assert accepted > 20, "changes of what is free, as in `training`, are no faults"

"""The document inside the model file: what is written comes back, what is wrong is named."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest

from runtime import ClassInfo, Contract, ContractError
from runtime.contract.contract import ModelContent
from runtime.contract.heads import HEADS


@pytest.fixture
def contract(contract: Contract) -> Contract:
    return dataclasses.replace(contract, content=ModelContent(bytes=7, sha256="1" * 64))


def sealed(document: dict) -> str:
    """The text of a document, with its digest as its last key."""
    body = json.dumps({key: value for key, value in document.items() if key != "document_sha256"})
    body = body.removesuffix("}")
    return f'{body}, "document_sha256": "{hashlib.sha256(body.encode()).hexdigest()}"}}'


def document(contract: Contract, **changes: object) -> str:
    return sealed(json.loads(contract.to_json()) | changes)


def test_what_is_written_comes_back(contract):
    back = Contract.from_json(contract.to_json())
    assert back == contract
    assert back.classes[1] == ClassInfo("red", (200, 30, 30))
    assert back.native_size == (48, 64)


@pytest.mark.parametrize("version", ["1.3", "1.40", "new"])
def test_another_version_is_refused_and_named(contract, version):
    with pytest.raises(ContractError, match=rf"'{version}'.* 1\.4"):
        Contract.from_json(document(contract, schema_version=version))


@pytest.mark.parametrize("key", Contract.__dataclass_fields__)
def test_a_missing_key_is_named(contract, key):
    content = json.loads(contract.to_json())
    del content[key]
    with pytest.raises(ContractError, match=f"lacks the key '{key}'"):
        Contract.from_json(sealed(content))


def test_the_document_holds_its_own_digest(contract):
    text = contract.to_json()
    assert text == sealed(json.loads(text))
    assert list(json.loads(text))[-2:] == ["content", "document_sha256"]
    for fault in (
        text.replace("by-hand", "by-hind"),
        text.replace('"document_sha256"', '"document_sha257"'),
        text.replace(", ", ","),
        text + " ",
        text[:-3] + ("1" if text[-3] == "0" else "0") + text[-2:],
    ):
        with pytest.raises(ContractError):
            Contract.from_json(fault)


@pytest.mark.parametrize(("key", "value"), [
    ("model_name", 3), ("classes", ["road"]), ("classes", [{"name": "a", "color": [1, 2]}]),
    ("classes", [{"name": "a", "color": [1, 2, 256]}]),
    ("classes", [{"name": "a", "color": [1, 2, "3), url(//host"]}]),  # pages write CSS of it
    ("classes", [{"name": "a", "color": [1, 2, 3]}] * 2),
    ("classes", [{"name": str(i), "color": [1, 2, 3]} for i in range(256)]),
    ("classes", [{"name": "ro\nad", "color": [1, 2, 3]}]),
    ("max_depth_m", 0), ("max_depth_m", np.nan), ("canonical_focal_px", 1e7),
    ("trained_height", 0), ("native_size", [48]), ("native_size", [16_384, 16_384]),
    ("stride", 0), ("precision", None), ("quantization", ""), ("giga_macs", -1),
    ("training", {"terms": "\ud800"}), ("versions", {"torch": 2}),
    ("parity", {"depth": {"max_abs_m": np.inf}}), ("content", {"bytes": 7.0, "sha256": "1" * 64}),
])  # fmt: skip
def test_a_wrong_value_is_named(contract, key, value):
    with pytest.raises(ContractError, match="damaged: "):
        Contract.from_json(document(contract, **{key: value}))


def test_the_resize_rules_are_written_for_other_engines_and_not_read(contract):
    rules = json.loads(contract.to_json())["resize"]
    assert rules.pop("rgb") == "bilinear"
    assert rules.pop("sparse_depth") == "nearest"
    assert rules == {head.name: head.resize for head in HEADS.values()}
    for other in ({"sparse_depth": "bilinear"}, {}, None):
        assert Contract.from_json(document(contract, resize=other)) == contract


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000])
def test_what_is_no_document_is_refused(text):
    with pytest.raises(ContractError, match="ssdnet-export"):
        Contract.from_json(text)

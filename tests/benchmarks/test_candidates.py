"""The candidates by name."""

import sys

import pytest
import torch

import candidates
from models import SSDNet


def test_an_unknown_candidate_is_named_with_those_that_are_known(monkeypatch, capsys):
    known = {"ssdnet-lite": candidates.LITE, "other": candidates.LITE}
    monkeypatch.setattr(candidates, "candidates", lambda: known)
    monkeypatch.setattr(sys, "argv", ["candidates.py", "--only", "other", "stem 1"])
    with pytest.raises(SystemExit) as error:
        candidates.main()
    assert error.value.code == 2
    said = capsys.readouterr().err
    assert "--only 'stem 1': no such candidate; known: ssdnet-lite, other\n" in said


@pytest.mark.parametrize("name", candidates.candidates())
def test_every_candidate_can_be_built(name):
    config = candidates.candidates()[name]
    with torch.device("meta"):
        answer = SSDNet(config)(torch.empty(2, 3, 64, 96), torch.empty(2, 1, 64, 96))
    assert (answer.semantic_logits is not None) == ("semantic" in config.heads)
    assert (answer.depths is not None) == ("depth" in config.heads)

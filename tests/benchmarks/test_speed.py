"""The comparison of networks: which model a name means, and a run from the command line."""

import sys
from functools import partial

import onnx
import pytest
import torch

import speed
from models import create_model
from runtime.errors import InputError, SSDNetError
from speed import LogitsGraph, Timed, figures, measure, random_frame, to_markdown
from training.evaluation.classical.ip_basic import IPBasic
from training.evaluation.classical.nearest import Nearest

SIZE = (32, 48)


def test_a_name_is_a_bundled_file_before_a_network_of_random_weights(monkeypatch):
    exported = []
    monkeypatch.setattr(speed, "export_random", lambda name: exported.append(name) or b"random")
    bundled = speed.load_network("ssdnet-lite")
    assert len(bundled) > 1e6
    assert exported == []
    assert speed.load_network("random:ssdnet-lite") == b"random"
    assert speed.load_network("fast-scnn") == b"random"
    assert exported == ["ssdnet-lite", "fast-scnn"]
    assert isinstance(speed.load_network("ip-basic"), IPBasic)


def test_an_unknown_name_lists_all_that_are_known():
    with pytest.raises(InputError, match=r"called 'mobilenet'; there are: .*ssdnet-lite.*pidnet-s"):
        speed.load_network("mobilenet")
    with pytest.raises(SSDNetError, match=r"no\.onnx"):
        speed.load_network("no.onnx")
    with pytest.raises(SSDNetError, match=r"no\.pt"):
        speed.load_network("no.pt")


def test_a_run_prints_a_table_a_size_and_leaves_out_what_does_not_fit(
    monkeypatch, capsys, small_model
):
    files = {"free": small_model(), "fixed": small_model(64, 96), "filling": Nearest()}
    monkeypatch.setattr(speed, "load_network", files.__getitem__)
    options = ["--sizes", "32x48", "64x96", "--threads", "1", "--rounds", "2"]
    monkeypatch.setattr(sys, "argv", ["speed.py", *files, *options])
    speed.main()
    text = capsys.readouterr().out
    assert "1 threads" in text
    _, small, large = text.split("**")[::2]
    assert "**32 x 48**" in text
    assert "**64 x 96**" in text
    assert "| fixed |" not in small
    for name in files:
        row = next(line for line in large.splitlines() if line.startswith(f"| {name} |"))
        times = [float(cell) for cell in row.split("|")[4:-1]]
        assert all(time > 0 for time in times)
    assert "| filling | 0.00 | 0.00 |" in large
    assert "ratio to free" in text
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--reference", "fixed"])
    with pytest.raises(SystemExit, match="fixed is of fixed size: it does not take 32x48"):
        speed.main()
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--reference", "other"])
    with pytest.raises(SystemExit):
        speed.main()
    assert "--reference other: is none of the networks: free, fixed" in capsys.readouterr().err


def count(model, size=SIZE):
    return speed.count_cost(model, {"rgb": random_frame(size)["rgb"]})


def test_costs_are_those_by_hand(small_model):
    onnx.checker.check_model(onnx.load_from_string(small_model()))
    params_m, gmacs = count(small_model())
    assert params_m == pytest.approx((8 * 3 * 9 + 8 + 8 * 5 * 4) / 1e6)
    half = (SIZE[0] // 2) * (SIZE[1] // 2)
    assert gmacs == pytest.approx((half * 8 * 3 * 9 + half * 8 * 5 * 4) / 1e9)


def test_weights_that_are_used_twice_are_counted_once(small_model):
    model = onnx.load_from_string(small_model())
    again = onnx.helper.make_node(
        "Conv", ["y", "w1"], ["z2"], kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4
    )
    model.graph.node.insert(3, again)
    once, twice = count(small_model()), count(model.SerializeToString())
    assert twice[0] == once[0]
    assert twice[1] == once[1] + (SIZE[0] // 2) * (SIZE[1] // 2) * 8 * 3 * 9 / 1e9


def test_runs_are_interleaved_and_the_first_ones_do_not_count():
    order = []
    items = [Timed(name, 1, 2, partial(order.append, name)) for name in "ab"]
    measure(items, rounds=3)
    assert order == list("ab" * 5)
    assert [len(item.latencies_ms) for item in items] == [3, 3]
    assert [len(item.busy_ms) for item in items] == [3, 3]


def test_a_ratio_is_the_median_of_the_rounds_ratios():
    """A machine that becomes three times as slow changes times, not ratios."""
    first = Timed("first", 1, 2, None, [10, 30, 10], [4, 4, 4])
    second = Timed("second", 1.5, 2.5, None, [20, 60, 90], [2, 2, 2])
    one, two = figures([first, second], first)
    assert (one["ratio"], one["median_ms"], one["min_ms"]) == (1, 10, 10)
    assert (two["ratio"], two["median_ms"], two["min_ms"], two["cpu_ratio"]) == (2, 60, 20, 0.5)
    lines = to_markdown([one, two], "first").splitlines()
    assert "ratio to first" in lines[0]
    assert lines[3] == "| second | 1.50 | 2.50 | 60.0 | 20.0 | 2.00 | 2.0 | 0.50 |"


def test_logits_of_others_are_those_of_the_network_at_full_size():
    network = create_model("fast-scnn", num_classes=19).eval()
    rgb = torch.randint(0, 256, (1, 50, 70, 3), dtype=torch.uint8)
    with torch.no_grad():
        (logits,) = LogitsGraph(network)(rgb, torch.zeros(1, 50, 70))
        expected = network(rgb.permute(0, 3, 1, 2).float(), torch.zeros(1, 1, 50, 70))
    assert logits.shape == (1, 19, 50, 70)
    torch.testing.assert_close(logits, expected.semantic_logits)

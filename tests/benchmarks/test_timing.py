"""What the benchmarks share: counts by hand, turns, ratios."""

import onnx
import pytest
import torch

import timing
from models import create_model
from timing import LogitsGraph, Timed, count_cost, figures, measure, open_timed, to_markdown
from training.evaluation.classical import create_method

SIZE = (32, 48)


def test_costs_are_those_by_hand(small_model):
    onnx.checker.check_model(onnx.load_from_string(small_model()))
    cost = count_cost(small_model(), SIZE)
    assert cost.params_m == pytest.approx((8 * 3 * 9 + 8 + 8 * 5 * 4) / 1e6)
    half = (SIZE[0] // 2) * (SIZE[1] // 2)
    assert cost.gmacs == pytest.approx((half * 8 * 3 * 9 + half * 8 * 5 * 4) / 1e9)


def test_weights_that_are_used_twice_are_counted_once(small_model):
    model = onnx.load_from_string(small_model())
    again = onnx.helper.make_node(
        "Conv", ["y", "w1"], ["z2"], kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4
    )
    model.graph.node.insert(3, again)
    once, twice = (count_cost(m, SIZE) for m in (small_model(), model.SerializeToString()))
    assert twice.params_m == once.params_m
    assert twice.gmacs == once.gmacs + (SIZE[0] // 2) * (SIZE[1] // 2) * 8 * 3 * 9 / 1e9


def test_a_classical_method_is_timed_beside_the_files(small_model):
    models = {"small": small_model(), "filling": create_method("nearest")}
    items = [open_timed(name, model, SIZE, threads=1) for name, model in models.items()]
    measure(items, SIZE, rounds=2)
    filling = figures(items, items[0])[1]
    assert filling["median_ms"] > 0
    assert (filling["params_m"], filling["gmacs"]) == (0, 0)


def test_a_file_of_fixed_size_is_not_timed_at_another(small_model):
    assert open_timed("a", small_model(*SIZE), SIZE, threads=1) is not None
    assert open_timed("a", small_model(*SIZE), (64, 48), threads=1) is None
    assert open_timed("a", small_model(), (64, 48), threads=1) is not None


def test_all_run_in_turn_and_the_first_runs_do_not_count(monkeypatch):
    order = []

    class Session:
        def __init__(self, name):
            self.name = name

        def get_inputs(self):
            return []

        def run(self, outputs, inputs):
            order.append(self.name)

    items = [Timed(name, timing.Cost(1, 2), Session(name)) for name in "ab"]
    measure(items, SIZE, rounds=3)
    assert order == list("ab" * 5)
    assert [len(item.latencies_ms) for item in items] == [3, 3]
    assert [len(item.busy_ms) for item in items] == [3, 3]


def test_a_ratio_is_the_median_of_the_rounds_ratios():
    """A machine that becomes three times as slow changes times, not ratios."""
    first = Timed("first", timing.Cost(1, 2), None, [10, 30, 10], [4, 4, 4])
    second = Timed("second", timing.Cost(1.5, 2.5), None, [20, 60, 90], [2, 2, 2])
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

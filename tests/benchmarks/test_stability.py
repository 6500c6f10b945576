"""The probes on predictors whose answers can be counted by hand."""

import json
import os
import sys

import numpy as np
import pytest

import stability
from models import CLASS_TABLES
from runtime.errors import InputError
from stability import (
    CUT_COLUMNS,
    Frame,
    format_table,
    match_pixels,
    optical_flow,
    probe_border,
    probe_false_returns,
    probe_flicker,
    probe_lidar,
    probe_pseudo_lidar,
    probe_seam,
    probe_shift,
    run_probes,
    seam_jumps,
    take,
)
from training.datasets.sample import Sample
from training.evaluation.scored_model import ScoredModel
from training.evaluation.scoring import HeadMaps

HEIGHT, WIDTH = 20, 100


def frame(returns=()):
    """Every column has a value of its own; returns of 20 m at (row, column)."""
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    rgb[:] = np.arange(WIDTH, dtype=np.uint8)[:, None]
    depth = np.zeros((HEIGHT, WIDTH), np.float32)
    for row, column in returns:
        depth[row, column] = 20
    return Frame(rgb, depth, 700.0)


def answer(like, semantic=3, depth=20.0):
    size = like.shape[:2]
    return HeadMaps(np.full(size, semantic, np.uint8), np.full(size, depth, np.float32), None)


def test_an_answer_that_moves_with_the_image_does_not_change():
    def predict(rgb, sparse_depth, focal_length_px):
        return HeadMaps(rgb[..., 0] // 10, rgb[..., 0] + np.float32(1), None)

    assert probe_shift(predict, [frame()], sky=None) == {"shift_depth": 0, "shift_class": 0}


def test_image_and_depth_map_are_cut_on_the_left():
    seen = []

    def predict(rgb, sparse_depth, focal_length_px):
        seen.append((int(rgb[0, 0, 0]), int(np.nonzero(sparse_depth)[1][0]), focal_length_px))
        return answer(rgb)

    probe_shift(predict, [frame([(4, 50)])], sky=None)
    assert seen == [(cut, 50 - cut, 700.0) for cut in (0, *CUT_COLUMNS)]


def test_changes_by_a_cut_are_shares_of_the_compared_pixels():
    """Frames of an odd width are 6 % farther and all of another class: cuts by 1, 3 and 5."""

    def predict(rgb, sparse_depth, focal_length_px):
        odd = rgb.shape[1] % 2
        return answer(rgb, semantic=3 + odd, depth=20 + 1.2 * odd)

    widths = {cut: WIDTH - cut - 32 for cut in CUT_COLUMNS}
    expected = sum(widths[cut] for cut in (1, 3, 5)) / sum(widths.values())
    figures = probe_shift(predict, [frame(), frame()], sky=None)
    assert figures == {
        "shift_depth": pytest.approx(expected),
        "shift_class": figures["shift_depth"],
    }
    assert np.isnan(probe_shift(predict, [frame()], sky=3)["shift_depth"])


def test_neither_the_left_columns_nor_pixels_near_a_return_nor_sky_count():
    """Of the counted columns of a cut frame the depth changes in `changed`."""

    def predict_changes(changed):
        def predict(rgb, sparse_depth, focal_length_px):
            result = answer(rgb)
            result.semantic[:, rgb[0, :, 0] >= 90] = 0
            if rgb.shape[1] < WIDTH:
                result.depth[:, changed(rgb[0, :, 0], np.arange(rgb.shape[1]))] = 25
            return result

        return predict

    def depth_change(changed):
        scan = frame([(row, 60) for row in range(HEIGHT)])
        return probe_shift(predict_changes(changed), [scan], sky=0)["shift_depth"]

    assert depth_change(lambda column, place: place < 32) == 0
    assert depth_change(lambda column, place: place == 32) > 0
    assert depth_change(lambda column, place: (column >= 54) & (column <= 66)) == 0
    assert depth_change(lambda column, place: column == 53) > 0
    assert depth_change(lambda column, place: column >= 90) == 0
    assert depth_change(lambda column, place: column == 89) > 0


def test_the_lidar_share_is_of_all_pixels():
    def predict(rgb, sparse_depth, focal_length_px):
        result = answer(rgb)
        if sparse_depth.any():
            result.semantic[:, :25] = 8
        return result

    assert probe_lidar(predict, [frame([(2, 2)])]) == {"lidar_class": 0.25}


def test_false_returns_are_far_and_within_the_scan():
    spoiled = []

    def predict(rgb, sparse_depth, focal_length_px):
        """5 m left of column 40, 20 m right; a return of 3 m is believed in its whole column."""
        result = answer(rgb)
        result.depth[:, :40] = 5
        result.depth[:, (sparse_depth == 3).any(axis=0)] = 3
        spoiled.append(sparse_depth)
        return result

    scan = frame([(row, column) for row in range(HEIGHT) for column in (10, 60)])
    figures = probe_false_returns(predict, [scan])
    rows, columns = np.nonzero(spoiled[1] == 3)
    assert len(rows) == 12
    assert (np.abs(columns - 60) <= 6).all()
    assert figures == {"false_px": HEIGHT * len(set(columns)) / 12}
    assert not (scan.sparse_depth == 3).any()
    first = spoiled[1]
    probe_false_returns(predict, [scan])
    assert (spoiled[3] == first).all()


def test_fewer_places_than_false_returns_have_one_each():
    def predict(rgb, sparse_depth, focal_length_px):
        result = answer(rgb, depth=5)
        result.depth[8, 60:65] = 20
        result.depth[sparse_depth == 3] = 3
        return result

    assert probe_false_returns(predict, [frame([(8, 62)])]) == {"false_px": 1.0}


def test_without_a_place_for_false_returns_there_is_no_figure():
    assert np.isnan(probe_false_returns(lambda rgb, *_: answer(rgb), [frame()])["false_px"])


def seam_of(above, above_alone, *, change=lambda result: None, sky=None):
    """The seam at a scan from row 20 of 40 down: 10 m below it, alone as far there."""
    scan = np.zeros((40, 60), np.float32)
    scan[20::4, ::4] = 10

    def predict(rgb, sparse_depth, focal_length_px):
        result = answer(rgb, depth=10)
        result.depth[:20] = above if sparse_depth.any() else above_alone
        change(result)
        return result

    return probe_seam(predict, [Frame(np.zeros((40, 60, 3), np.uint8), scan)], sky=sky)["seam"]


@pytest.mark.parametrize(
    ("above", "above_alone", "expected"),
    [
        (40, 10, np.log(4)),  # a jump that the camera does not see
        (40, 20, np.log(2)),  # the part that it does not see
        (40, 40, 0),
        (10, 40, 0),  # no jump
        (20, 40, 0),
        (5, 40, np.log(2)),  # the other way
        (5, 2.5, 0),
    ],
)
def test_a_seam_is_the_jump_beyond_the_cameras(above, above_alone, expected):
    assert seam_of(above, above_alone) == pytest.approx(expected, abs=1e-6)


def test_a_seam_is_seen_where_one_class_that_is_not_sky_goes_across():
    def part(result):
        result.semantic[:, :30] = 0
        result.depth[:, 30:] = 10

    assert seam_of(40, 10, change=part) == pytest.approx(np.log(4) / 2)
    assert seam_of(40, 10, change=part, sky=0) == 0

    def split(result):
        part(result)
        result.semantic[17, 30:] = 5

    assert seam_of(40, 10, change=split) == pytest.approx(np.log(4))
    assert np.isnan(seam_of(40, 10, change=split, sky=0))


def test_the_edge_is_the_highest_return_of_the_columns_around():
    measured = np.zeros((40, 60), np.bool_)
    measured[16, 30] = measured[3, 5] = True  # the second too high for a step across it
    depth = np.full((40, 60), 10, np.float32)
    depth[:16] = 40
    one, alone = (answer(depth, depth=10) for _ in range(2))
    jumps = seam_jumps(one._replace(depth=depth), alone, measured, sky=None)
    assert np.flatnonzero(~np.isnan(jumps)).tolist() == list(range(22, 39))
    assert jumps[22:39] == pytest.approx(np.log(4))


def test_the_border_is_what_is_not_sky_above_sky():
    """Of 10 columns of sky two have other rows at the border, of other columns all."""

    def predict(rgb, sparse_depth, focal_length_px):
        result = answer(rgb)
        result.semantic[:12, :10] = 0
        result.semantic[0, 3] = 1
        result.semantic[:6, 7] = 1
        result.semantic[:6, 50:] = 0
        return result

    assert probe_border(predict, [frame()], sky=0) == {"border": 7 / 60}
    assert np.isnan(probe_border(predict, [frame()], sky=9)["border"])
    assert np.isnan(probe_border(predict, [frame()], sky=None)["border"])


def steps(right):
    flow = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    flow[..., 0] = right
    return flow


def test_flicker_is_measured_along_the_flow():
    """All moves 2 px right and 1.5 m nearer, in the second case a fifth of it farther than that."""

    def follow(rgb, next_rgb):
        return steps(2.0 if next_rgb[0, 0, 0] else -2.0)

    def predict(rgb, sparse_depth, focal_length_px):
        depth = np.tile(np.linspace(5, 50, WIDTH, dtype=np.float32), (HEIGHT, 1))
        semantic = np.tile(np.arange(WIDTH) // 10, (HEIGHT, 1)).astype(np.uint8)
        if rgb[0, 0, 0]:
            depth, semantic = np.roll(depth, 2, 1) - np.float32(1.5), np.roll(semantic, 2, 1)
            if rgb[0, 0, 0] == 2:
                depth[:4] *= np.float32(np.exp(0.5))
                semantic[0] = 99
        return HeadMaps(semantic, depth, None)

    def flicker(second):
        first = Frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.float32))
        pair = [first, first._replace(rgb=np.full_like(first.rgb, second))]
        return probe_flicker(predict, pair, follow=follow)

    assert flicker(1) == {"flicker_depth": pytest.approx(0, abs=1e-5), "flicker_class": 0}
    assert flicker(2) == {"flicker_depth": pytest.approx(0.5), "flicker_class": 1 / HEIGHT}


def test_between_pixels_the_class_is_the_nearest_pixels():
    def predict(rgb, sparse_depth, focal_length_px):
        return HeadMaps(rgb[..., 0] // 10, rgb[..., 0] + np.float32(1), None)

    flows = iter((steps(0.4), steps(-0.4)))
    figures = probe_flicker(predict, [frame(), frame()], follow=lambda *_: next(flows))
    assert figures["flicker_class"] == 0
    kept = match_pixels(steps(0.4), steps(-0.4))[1]
    assert kept[:, :-1].all()
    assert not kept[:, -1].any()


def test_pixels_that_are_not_found_again_do_not_count():
    there, kept = match_pixels(steps(3), steps(-3))
    assert (there[5, 7] == (10, 5)).all()
    assert kept[:, : WIDTH - 3].all()
    assert not kept[:, WIDTH - 3 :].any()  # out of the frame
    backward = steps(-3)
    backward[:10] += 0.6
    kept = match_pixels(steps(3), backward)[1]
    assert not kept[:9].any()
    assert kept[11:, : WIDTH - 3].all()
    nothing = probe_flicker(
        lambda rgb, *_: answer(rgb), [frame(), frame()], follow=lambda *_: steps(WIDTH)
    )
    assert np.isnan([*nothing.values()]).all()


def test_the_optical_flow_points_to_the_next_frame():
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (16, 24, 3), np.uint8)
    image = np.kron(coarse, np.ones((8, 8, 1), np.uint8))
    flow = optical_flow(image, np.roll(image, (2, 3), (0, 1)))
    assert np.median(flow, axis=(0, 1)) == pytest.approx([3, 2], abs=0.3)


def test_pseudo_lidar_is_lines_of_the_models_own_depth_without_the_sky():
    fed = []

    def predict(rgb, sparse_depth, focal_length_px):
        fed.append((sparse_depth, focal_length_px))
        result = answer(rgb, depth=20)
        result.semantic[:160] = 0  # a dozen lines above the horizon, too
        result.semantic[200:] = 8 if sparse_depth.any() else 3
        return result

    labels = np.full((300, 400), 3, np.uint8)
    labels[:160], labels[200:] = 0, 8
    rgb = np.zeros((300, 400, 3), np.uint8)
    figures = probe_pseudo_lidar(predict, [(rgb, labels)], sky=0, num_classes=11)
    assert figures["camvid_miou"] == pytest.approx((1 + 40 / 140 + 0) / 3)
    assert figures["camvid_miou_pseudo_lidar"] == 1
    (alone, _), (lines, focal_length_px) = fed
    assert focal_length_px is None
    assert not alone.any()
    assert not lines[:160].any()
    assert lines[lines > 0] == pytest.approx(20, abs=0.2)
    rows = np.flatnonzero(lines[:, 200])  # 1/3 degree apart at 417 px
    assert np.median(np.diff(rows[:15])) in (2, 3)
    assert 0.01 < np.mean(lines[160:] > 0) < 0.5


def samples():
    depth = np.full((HEIGHT, WIDTH), 20, np.float32)
    unknown = np.full((HEIGHT, WIDTH), 3, np.uint8)
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    return [Sample(rgb, {"depth": depth, "semantic": unknown}, None, "a", sparse_depth=depth)] * 2


@pytest.mark.parametrize(("classes", "missing"), [("camvid", set()), ("cityscapes", {"camvid"})])
def test_a_row_has_every_figure_that_its_model_can_have(classes, missing):
    model = ScoredModel(lambda rgb, *_: answer(rgb), CLASS_TABLES[classes], "by hand")
    figures = run_probes(model, samples(), samples(), samples())
    known = {key for key, _, _ in stability.COLUMNS if key.split("_")[0] not in missing}
    # Every pixel has a return, and none is sky.
    assert figures.keys() == known - {"shift_depth", "seam", "border"}
    model = ScoredModel(
        lambda rgb, *_: answer(rgb)._replace(depth=None), CLASS_TABLES[classes], "by hand"
    )
    with pytest.raises(InputError, match="semantic and depth"):
        run_probes(model, samples(), samples(), samples())


def test_frames_are_spread_or_the_first_ones():
    source = list(range(11))
    assert take(source, None, spread=True) == source
    assert take(source, 3, spread=True) == [0, 5, 10]
    assert take(source, 3, spread=False) == [0, 1, 2]
    assert take(source, 20, spread=False) == source


def test_the_table_leaves_a_missing_figure_empty():
    _, _, row = format_table({"a": {"shift_depth": 0.354, "false_px": 469.0}}).splitlines()
    assert row == "| a | 35.40 |  |  | 469.00 |" + "  |" * 6


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="SSDNET_DATA names no recordings")
def test_a_bundled_model_on_recorded_frames(tmp_path, monkeypatch, capsys):
    out = tmp_path / "rows.json"
    command = ["stability.py", "ssdnet-nano", "--data", os.environ["SSDNET_DATA"]]
    command += ["--limit", "2", "--threads", "1", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", [*command, "--drive", "kitti_stream", "--flicker", "50:59"])
    stability.main()
    assert "| ssdnet-nano.onnx |" in capsys.readouterr().out
    figures = json.loads(out.read_text())["ssdnet-nano.onnx"]
    assert figures.keys() == {key for key, _, _ in stability.COLUMNS}
    assert 0.1 < figures["shift_depth"] < 0.7
    assert figures["flicker_class"] < 0.05
    assert figures["camvid_miou"] > 0.4

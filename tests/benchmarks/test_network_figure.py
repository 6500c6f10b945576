"""The figure of the network shows what its modules compute."""

from models import create_model
from network_figure import COLUMNS, find_arrows, find_boxes


def test_boxes_are_the_grids_of_the_modules():
    network = create_model("ssdnet-nano")
    titles = [title for title, _ in COLUMNS]
    found = find_boxes(network)
    assert [box.stride for box in found[:3]] == [1, 2, 4], "the candidates of the depth come first"
    assert found[-1].name == "surface_depth"
    boxes = [box for box in found if box.column == titles.index("classes")]
    *decoder, head = [(box.stride, box.channels) for box in boxes]
    assert decoder == list(zip((16, 8, 4), network.config.decoder_channels, strict=True))
    assert head == (network.semantic_stride, network.config.num_classes)


def test_arrows_are_what_a_module_is_computed_from():
    boxes = find_boxes(create_model("ssdnet-small"))
    arrows = {(source.name, box.name) for source, box in find_arrows(boxes)}
    into = {source for source, box in arrows if box == "semantic_decoder.blocks.1"}
    assert into == {"semantic_decoder.blocks.0", "encoder.stages.2", "boundary_decoder.sides.2"}
    assert {box for source, box in arrows if source == "semantic_head"} == set()
    assert ("encoder.stages.0", "encoder.stages.2") not in arrows, "only through stage 1"

"""CamVid: images and, in a folder beside them, their labels."""

from layouts.pictures import write


def write_frame(root, rgb, label, name="a_1", split="train"):
    write(root / split / f"{name}.png", rgb)
    write(root / f"{split}annot" / f"{name}.png", label)

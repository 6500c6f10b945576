"""One street of PandaSet (CC BY 4.0) as data sets: each camera in a folder of its own.

`CAMERA/image` has pictures of 800 x 450, `CAMERA/lidar` the returns at these pixels (16-bit PNG,
metres x 256), `CAMERA/label` the class of each return (CamVid's ids, 255 = none).
"""

from training.datasets.folders import FoldersRecipe

#: The attribution that the licence asks for.
TERMS = (
    "PandaSet (sequence 002, images reduced to 800 x 450, classes mapped to CamVid's): by Scale AI "
    "and Hesai, https://pandaset.org, CC BY 4.0, https://creativecommons.org/licenses/by/4.0/"
)
# fx, fy, cx and cy [px] at a width of 1920.
CAMERAS = {
    "front": (1970.0, 1970.0, 970.0, 483.3),
    "front_left": (929.8, 930.1, 972.2, 508.0),
    "front_right": (930.0, 930.0, 965.1, 463.4),
    "left": (930.5, 930.1, 991.7, 541.6),
    "right": (922.5, 922.4, 945.1, 517.6),
    "back": (933.5, 934.7, 896.5, 507.4),
}


def camera(name: str, weight: float = 1.0, semantic_weight: float = 1.0) -> FoldersRecipe:
    """Return a camera's frames; `right` is kept for validation.

    A part of the returns is the input, and the others are the target. One pixel in 15 to 40 has a
    class. Returns of poles have none, and the sky has no return.
    """
    fx, fy, cx, cy = (value * 800 / 1920 for value in CAMERAS[name])
    return FoldersRecipe(
        path=f"pandaset_street/{name}",
        rgb="image",
        depth="lidar",
        scan=True,
        labels="label",
        lacking=("sky", "pole"),
        semantic_weight=semantic_weight,
        intrinsics=(fx, fy, cx, cy),
        weight=weight,
    )


def cameras(weight: float, semantic_weight: float = 1.0) -> tuple[FoldersRecipe, ...]:
    """Return all cameras that are trained on, which share `weight`."""
    names = [name for name in CAMERAS if name != "right"]
    return tuple(camera(name, weight / len(names), semantic_weight) for name in names)

"""Keys of recipes that earlier releases had, and what replaces each of them."""

from collections.abc import Mapping

#: Key, without the indices of lists -> what to do now.
FORMER_KEYS: Mapping[str, str] = {
    "data.paste_classes": "nothing replaces it; things of other frames are not pasted",
    "data.source.things": "nothing replaces it; things of other frames are not pasted",
    "data.augment.paste": "nothing replaces it; things of other frames are not pasted",
    "data.augment.style": "nothing replaces it; frames keep their own colours",
    "data.augment.lidar_solid_state": "nothing replaces it; see data.augment.lidar_random",
    "loop.logit_adjustment": "it is release.logit_adjustment now",
    "loop.logit_offsets": "it is release.logit_offsets now",
    "loop.trained_share": "it is release.trained_share now",
}

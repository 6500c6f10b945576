"""Keys of recipes that earlier releases had, and what replaces each of them."""

from collections.abc import Mapping

#: Key, without the indices of lists -> what to do now.
FORMER_KEYS: Mapping[str, str] = {
    "loop.logit_adjustment": "it is release.logit_adjustment now",
    "loop.logit_offsets": "it is release.logit_offsets now",
    "loop.trained_share": "it is release.trained_share now",
}

"""The options in messages: the library names them as Python does, a command by its flags."""

import re

# A keyword of a function in a message, such as `points=` or `registered=True`.
_KEYWORD = re.compile(r"`(\w+)=([^`\s]*)`")
_OF_SOURCE = " in --source"
# The flags of keywords; those that `SOURCE_KEYS` lists are keys of --source.
_SAME = (
    *("calibrate", "calibration", "depth", "max_skew_ms", "max_slowdown", "model", "out"),
    *("overwrite", "points", "poses", "rectify", "reuse_depth_ms", "rgb", "size", "validate"),
)
_FLAGS = {name: f"--{name.replace('_', '-')}" for name in _SAME} | {
    "kind": "--source KIND:PATH",
    "memory_s": "--memory",
    "tolerances": "--tolerance",
}


def with_flags(text: str) -> str:
    """Return a message in which the keywords in backticks are the options of a command."""
    return re.sub(rf"{_OF_SOURCE}(?=, \w+=)", "", _KEYWORD.sub(_flag, text))


def _flag(keyword: re.Match[str]) -> str:
    from runtime.recordings.registry import SOURCE_KEYS  # loads OpenCV

    name, value = keyword.groups()
    if name in SOURCE_KEYS:
        return f"{name}={value.lower() if value in ('True', 'False') else value}{_OF_SOURCE}"
    return _FLAGS.get(name, keyword[0])

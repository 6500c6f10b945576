"""Counts files and lines of code of each package, and the words of each document.

    python benchmarks/count_code.py [FOLDER]

A line counts if it holds code; blank lines, comments and docstrings do not count. Words are counted
like `wc -w` does.
"""

import ast
import io
import sys
import tokenize
from pathlib import Path

PACKAGES = ("models", "training", "export", "runtime", "tests", "benchmarks", "examples")

# Tokens that are not code by themselves.
_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def count_lines(source: str) -> int:
    """Return the number of lines of Python source that hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(ast.Constant(str()), end_lineno=int(end)):  # a docstring
                lines.difference_update(range(node.lineno, end + 1))
    return len(lines)


def documents(root: Path) -> list[Path]:
    """Return the files that users read."""
    return [
        root / "README.md",
        root / "CONTRIBUTING.md",
        *sorted((root / "docs").glob("*.md")),
        *sorted((root / "runtime/assets").glob("*.md")),
    ]


def main() -> None:
    """Print a table of folders and one of documents."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    print(f"{'package':12}{'files':>7}{'lines':>8}")
    for package in PACKAGES:
        files = sorted((root / package).rglob("*.py"))
        lines = sum(count_lines(file.read_text()) for file in files)
        print(f"{package:12}{len(files):7}{lines:8}")
    print(f"\n{'document':34}{'words':>7}")
    words = {file: len(file.read_text().split()) for file in documents(root)}
    for file, count in words.items():
        print(f"{file.relative_to(root)!s:34}{count:7}")
    print(f"{'total':34}{sum(words.values()):7}")


if __name__ == "__main__":
    main()

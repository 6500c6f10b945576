"""Where the answers of a run go, a file an output."""

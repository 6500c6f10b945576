"""Reference answers: kept with their frames, and compared with the answers of another machine."""

"""Sources of frames, one file per kind; `registry` lists all of them."""

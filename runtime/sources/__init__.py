"""Sources of frames, a file a kind; `registry` names them all."""

"""Where frames come from, a file a kind; `registry` names them all."""

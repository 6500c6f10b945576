"""Models of any kind and classical methods of depth completion, opened and scored on data sets."""

"""The outputs of a run, one file for each."""

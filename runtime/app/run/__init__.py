"""Everything that runs streams of frames around a single `runtime.Predictor`."""

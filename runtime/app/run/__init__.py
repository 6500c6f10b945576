"""All that runs streams of frames around the one `runtime.Predictor`."""

"""One page of HTML that says how a run went, to open in a browser."""

"""Pictures of predictions, and the files that hold them."""

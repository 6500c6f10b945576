"""From data sets to batches: opening, resizing, caching, augmenting and mixing them."""

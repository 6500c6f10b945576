"""Pictures of answers, to look at."""

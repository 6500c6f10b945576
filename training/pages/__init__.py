"""Pictures of batches and of answers, and the page of an evaluation."""

"""Other people's networks, to compare with: one file each."""

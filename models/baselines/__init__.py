"""Published networks to compare with: one file each."""

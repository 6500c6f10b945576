"""Files: written whole or not at all, and read with checks of what they hold."""

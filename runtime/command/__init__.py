"""What the commands of all four packages share: signals, errors, options, facts, HTML pages."""

"""What every room of training uses: tables, limits of values, processes, signals that stop."""

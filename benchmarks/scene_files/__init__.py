"""Scene files of every kind, written by a writer of its own and read back."""

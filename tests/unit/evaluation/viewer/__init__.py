"""Pages that show rigs, data sets and results in space."""

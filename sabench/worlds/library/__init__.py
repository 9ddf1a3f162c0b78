"""Building blocks of generators: vortices, size distributions, packings, jets and surfaces."""

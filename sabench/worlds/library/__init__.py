"""Building blocks of generators: vortices, sizes, packings, surfaces."""

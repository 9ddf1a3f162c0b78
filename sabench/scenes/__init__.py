"""Scene files: their schema, their loading, and the rig of cameras that they describe."""

"""From a scene to a data set: rendering, recording and writing."""

"""Page that shows a rig, a data set or a result in space."""

"""Iterative particle reconstruction: particles as points with images, found by triangulation and fitted to what the cameras saw."""

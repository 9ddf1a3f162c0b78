"""Velocity from pairs of volumes: window correlation with volume deformation."""

"""Data sets on disk; docs/formats/dataset.md is their contract."""

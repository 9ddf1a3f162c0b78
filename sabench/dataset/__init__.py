"""The data set on disk: docs/formats/dataset.md is its contract."""

"""The data set on disk: docs/dataset-format.md is its contract."""

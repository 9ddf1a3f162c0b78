"""Suites, the runner, records and private test sets."""

"""Utilities of all other packages.

Array types, errors, random streams, files, validation, processes and the compute back end.
"""

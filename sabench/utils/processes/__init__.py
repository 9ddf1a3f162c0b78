"""Child processes: calls of functions, external programs, and Python's own modules and servers."""

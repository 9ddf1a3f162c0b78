"""Child processes: calls of functions, programs, Python modules and servers."""

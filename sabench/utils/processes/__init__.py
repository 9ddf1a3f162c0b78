"""Child processes.

Isolated function calls, limited external programs, Python modules, workers. `starting` and `ending`
are shared: the environment of children, Ctrl-C, last words, killing.
"""

"""Exchange with other programs: camera files, images, settings and results.

External programs run in a child process.
"""

"""Challenges on private test sets: organiser, participants and server."""

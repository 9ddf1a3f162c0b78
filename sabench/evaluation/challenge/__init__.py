"""Challenges on private test sets: the organiser's, the participants' and a server's part."""

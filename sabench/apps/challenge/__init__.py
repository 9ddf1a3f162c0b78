"""Challenges on private test sets: organiser, participants and server."""

from __future__ import annotations

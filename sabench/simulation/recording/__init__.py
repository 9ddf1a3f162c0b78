"""Resumable rendering of a scene, in small tasks.

Any process may do a task, in any order that the schedule allows; an interrupted one leaves nothing
half-written.
"""

"""Bubbles found and fitted in all views at once: votes for outlines, hypotheses in space, and a model of what a backlit bubble looks like."""

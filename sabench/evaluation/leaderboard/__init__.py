"""The leaderboard: its rows, its page, and submissions to it."""

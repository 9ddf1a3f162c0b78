"""The command `sabench`."""

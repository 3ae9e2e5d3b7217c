"""Recordings: MCAP in, MCAP out, the recorder and the player."""

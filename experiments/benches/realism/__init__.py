"""Realism: how much simulated traffic looks like the recorded traffic that it starts from."""

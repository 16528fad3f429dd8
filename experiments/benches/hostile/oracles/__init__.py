"""Slow independent readers, which share no code with ours."""

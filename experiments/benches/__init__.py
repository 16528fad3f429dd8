"""Benches: every measured figure, as tidy rows that name what was measured."""

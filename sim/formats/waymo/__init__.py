"""Waymo Open Motion scenarios: their records, messages and JSON."""

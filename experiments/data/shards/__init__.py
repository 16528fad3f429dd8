"""Datasets in shards: where they are made, in which parts, and rewritten from older ones."""

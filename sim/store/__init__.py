"""Datasets on disk: their schema, how episodes are written whole and read back."""

"""Datasets that several commands make together, without a scheduler."""

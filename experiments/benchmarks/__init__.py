"""Measures what the product does: each module is one command of ``graphrqi bench``."""

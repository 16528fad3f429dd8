"""Drivers among the other drivers of their place, for traffic whose level nobody knows.

A classifier that sees one driver at a time ranks the drivers of other traffic well and is offset as
a whole: a place where everybody drives close looks like a place of aggressive drivers. What all
drivers of a place are like shows much of that offset.
"""

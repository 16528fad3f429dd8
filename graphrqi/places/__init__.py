"""Drivers compared with the other drivers of their recording site.

A classifier that sees one driver at a time ranks the drivers of other traffic well, but its
probabilities are offset. A site with short headways, for example, looks like a site of aggressive
drivers. The averages over all drivers of the site show much of that offset.
"""

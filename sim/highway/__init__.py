"""The highway-env engine: the only package that imports highway_env.

highway-env has y to the right of x (south) and turns clockwise; everything here is in its axes.
Positions and headings are negated in y once, where a road or a frame passes the boundary.
"""

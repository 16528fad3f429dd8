"""Traffic graphs: vehicles are the nodes, nearness makes the edges.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> graph = TrafficGraph.from_edges([7, 8, 9], [(7, 8), (8, 9)])
    >>> graph.laplacian.toarray()
    array([[ 1., -1.,  0.],
           [-1.,  2., -1.],
           [ 0., -1.,  1.]])
"""

from graphrqi.graph.traffic_graph import MAX_COORDINATE_M, TrafficGraph, find_nearest

__all__ = ["MAX_COORDINATE_M", "TrafficGraph", "find_nearest"]

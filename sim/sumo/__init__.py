"""The SUMO engine: the only place that knows libsumo."""

"""Features for traffic of unknown kind: smoothed motion, and drivers relative to their scene."""

"""Roads of one's own: demand made from a net, routes from a file, scenarios from a file."""

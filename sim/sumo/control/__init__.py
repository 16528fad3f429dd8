"""Controllers for what SUMO's own models cannot do, such as rule breaking, cut-ins, jaywalking.

A controller acts after a simulation step on the agents whose profiles ask for it, in SUMO's order;
the random decisions of each agent come from its own generator.
"""

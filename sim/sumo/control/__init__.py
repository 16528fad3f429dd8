"""Controllers for what SUMO's own models cannot do, such as rule breaking, cut-ins, jaywalking.

Controllers act after a simulation step on the agents whose profiles ask for it, in SUMO's order.
Each agent's random decisions come from its own generator.
"""

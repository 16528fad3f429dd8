"""What drivers and pedestrians do that SUMO's own models cannot: small seeded controllers.

A controller acts after each simulation step, on the agents whose profile asks for it, in the order
in which SUMO lists them; each agent's chance decisions come from its own generator.
"""

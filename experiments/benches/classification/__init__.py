"""The classification bench: protocols that cannot leak, and how far each disturbance hurts."""

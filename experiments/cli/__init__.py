"""The ``graphrqi`` command, and how its commands talk to their user."""

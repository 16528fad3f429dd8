"""The ``graphrqi`` command."""

"""A four-way intersection where who comes from the right goes first.

The road and the demand are made by the function that `scenarios.SCENARIOS` names; this module is
the scenario's command.
"""

from __future__ import annotations

from scenarios.command import main

if __name__ == "__main__":
    raise SystemExit(main("right_before_left"))

"""A straight two-way road, one lane each way, where overtaking means the oncoming lane.

The road and the demand are made by the function that `scenarios.SCENARIOS` names; this module is
the scenario's command.
"""

from __future__ import annotations

from scenarios.command import main

if __name__ == "__main__":
    raise SystemExit(main("two_way_road"))

"""A motorway with an on-ramp and an off-ramp: merging, weaving, leaving."""

from __future__ import annotations

import functools
from typing import Final

from scenarios.motorway import motorway

motorway_ramps: Final = functools.partial(motorway, ramps=True)

if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("motorway_ramps"))

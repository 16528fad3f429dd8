"""A straight two-way road, one lane each way, where overtaking means the oncoming lane."""

from __future__ import annotations

import functools
from typing import Final

from scenarios.straight_road import straight_road

two_way_road: Final = functools.partial(straight_road, two_way=True, lanes=1, crossing=False)

if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("two_way_road"))

"""Every measured figure at full size: each bench's rows into ``runs/study``.

``python -m experiments.study`` (or ``make study``) goes on where it was stopped; remove a file to
measure it again.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from experiments.benches.registry import BENCHES
from experiments.console.exit_codes import exit_on_user_error
from experiments.console.notices import show_notices
from experiments.console.tables import write_rows


def run_study(out: Path) -> list[Path]:
    """Run every bench that has no result yet.

    Args:
        out: folder of the results, ``<bench>.json`` each.

    Returns:
        The files that there are now, old and new.
    """
    out.mkdir(parents=True, exist_ok=True)
    paths = {name: out / f"{name}.json" for name in BENCHES}
    for name, path in paths.items():
        if path.exists():
            print(f"{path}: is there", file=sys.stderr)
            continue
        bench = BENCHES[name]
        if bench.needs and not os.environ.get(bench.needs):
            print(f"{path}: skipped, {bench.needs} names no recordings", file=sys.stderr)
            continue
        print(f"{path}: measuring", file=sys.stderr, flush=True)
        write_rows(bench.run(bench.full), path)
    return [path for path in paths.values() if path.exists()]


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        run_study(Path("runs/study"))

"""Runs ASAM's own checkers over exported OpenSCENARIO and OpenDRIVE files.

    python -m venv asam-checkers
    asam-checkers/bin/pip install asam-qc-opendrive asam-qc-openscenarioxml
    python docs/check_asam.py asam-checkers FOLDER

The checkers need numpy < 2, hence an environment of their own. Every issue is printed; the program
ends with 1 if there is one that is an error.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

CHECKERS = {
    ".xodr": ("qc_opendrive", "xodrBundle"),
    ".xosc": ("qc_openscenario", "xoscBundle"),
}
"""For files of each ending: the program, and its bundle."""

LEVELS = {"1": "error", "2": "warning", "3": "information"}


def issues_of(checkers: Path, file: Path) -> Iterator[tuple[str, str, str]]:
    """The level, the rule and the words of every issue that a checker finds in a file.

    Args:
        checkers: the environment that they are installed in.
        file: an ``.xodr`` or ``.xosc`` file.

    Raises:
        RuntimeError: if the checker fails.
    """
    program, bundle = CHECKERS[file.suffix]
    with tempfile.TemporaryDirectory() as scratch:
        result = Path(scratch) / "result.xqar"
        settings = Path(scratch) / "settings.xml"
        settings.write_text(
            f'<Config><Param name="InputFile" value="{file.resolve()}"/>'
            f'<CheckerBundle application="{bundle}">'
            f'<Param name="resultFile" value="{result}"/></CheckerBundle></Config>'
        )
        command = [str(checkers / "bin" / program), "-c", str(settings)]
        done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, check=False)
        if done.returncode or not result.is_file():
            raise RuntimeError(f"{program} failed on {file}: {done.stderr.strip()[-300:]}")
        root = ET.parse(result).getroot()
    for checker in root.iter("Checker"):
        if checker.get("status") not in ("completed", "skipped"):
            yield "error", checker.get("checkerId", ""), f"did not run: {checker.get('status')}"
        for issue in checker.iter("Issue"):
            level = LEVELS.get(issue.get("level", ""), "unknown")
            where = "; ".join(one.get("description", "") for one in issue.iter("Locations"))
            yield level, issue.get("ruleUID", ""), f"{issue.get('description', '')} ({where})"


def main() -> int:
    """Check the files of a folder; 1 if there is an error."""
    checkers, folder = Path(sys.argv[1]), Path(sys.argv[2])
    files = sorted(file for file in folder.rglob("*") if file.suffix in CHECKERS)
    errors = 0
    for file in files:
        found = list(issues_of(checkers, file))
        errors += sum(level == "error" for level, _, _ in found)
        for level, rule, words in found:
            sys.stdout.write(f"{file.name}: {level}: {rule}: {words}\n")
    sys.stdout.write(f"{len(files)} files checked, {errors} errors\n")
    return int(errors > 0 or not files)


if __name__ == "__main__":
    raise SystemExit(main())

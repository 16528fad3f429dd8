"""``python -m experiments.cli`` is the ``graphrqi`` command."""

from experiments.cli.commands import main

if __name__ == "__main__":
    main()

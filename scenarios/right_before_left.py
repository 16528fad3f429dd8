"""``python -m scenarios.right_before_left`` runs this scenario headless."""

from scenarios import run_as_command

if __name__ == "__main__":
    run_as_command("right_before_left")

"""``python -m scenarios.priority_intersection`` runs this scenario headless."""

from scenarios import run_as_command

if __name__ == "__main__":
    run_as_command("priority_intersection")

"""``python -m scenarios.all_way_stop`` runs this scenario headless."""

from scenarios import run_as_command

if __name__ == "__main__":
    run_as_command("all_way_stop")
